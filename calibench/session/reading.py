"""Frames from files and folders, and the one rule for leaving a frame out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import BadInput, Contradiction
from ..io.frame_series import FrameSeries
from ..io.frames import read_frame
from ..records import Frame

MIXTURES = {"dark": {"dark"}, "flat": {"flat", "dark"}, "light": {"light"}}
SWAPPED = "states that it is a {stated} frame, which this measurement does not take: are the folders swapped?"


def read_or_reason(path: Path, kind: str, *, named: bool, sha256: str = "") -> Frame | BadInput:
    """The frame, or why it cannot be used. kind: what it is taken for if it does not say. sha256: of the file, if known.

    Raises:
        Contradiction: its sources exclude each other. BadInput: it was named outright and cannot be read.
    """
    try:
        return read_frame(path, kind, sha256=sha256)
    except BadInput as fault:
        if named or isinstance(fault, Contradiction):
            raise
        return fault


def read_arguments(arguments: Sequence[Path], paths: Sequence[Path], kind: str, tell: Callable[[int], None],
                   ) -> tuple[FrameSeries, list[tuple[str, str]]]:
    """Frames that belong together, and those of named folders that could not be used, with the reason; both come to be
    while the frames are iterated.

    A frame named outright is never left out silently: what is wrong with it is an error. kind: what a frame is taken
    for that does not say; darks may stand among flats.

    Raises (while the frames are iterated):
        Contradiction: sources exclude each other. BadInput: a named frame cannot be used, nothing is left, or the frames do
            not belong together.
    """
    named = {path.resolve() for path in arguments if not path.is_dir()}

    def read(path: Path, sha256: str) -> Frame | BadInput:
        must = path.resolve() in named
        frame = read_or_reason(path, kind, named=must, sha256=sha256)
        if isinstance(frame, Frame) and frame.kind not in MIXTURES[kind] | {"unknown"}:
            frame = BadInput(SWAPPED.format(stated=frame.kind), file=path, mend="correct the frame's kind, or leave it out")
            if must:
                raise frame
        return frame

    series = FrameSeries(paths, read, tell=tell)
    return series, series.rejected
