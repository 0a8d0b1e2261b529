"""Frames from files and folders, and the one rule for leaving a frame out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import BadInput, Contradiction
from ..io.frames import read_frame
from ..io.series_checks import check_series
from ..records import Frame

MIXTURES = {"dark": {"dark"}, "flat": {"flat", "dark"}, "light": {"light"}}
SWAPPED = "states that it is a {stated} frame, which this measurement does not take: are the folders swapped?"


def read_or_reason(path: Path, kind: str, *, named: bool) -> Frame | BadInput:
    """The frame, or why it cannot be used. kind: what it is taken for if it does not say.

    Raises:
        Contradiction: its sources exclude each other. BadInput: it was named outright and cannot be read.
    """
    try:
        return read_frame(path, kind)
    except BadInput as fault:
        if named or isinstance(fault, Contradiction):
            raise
        return fault


def read_arguments(arguments: Sequence[Path], paths: Sequence[Path], kind: str, tell: Callable[[int], None],
                   ) -> tuple[list[Frame], list[tuple[str, str]]]:
    """Frames that belong together, and those of named folders that could not be used, with the reason.

    A frame named outright is never left out silently: what is wrong with it is an error. kind: what a frame is taken
    for that does not say; darks may stand among flats.

    Raises:
        Contradiction: sources exclude each other. BadInput: a named frame cannot be used, nothing is left, or the frames do
            not belong together.
    """
    named = {path.resolve() for path in arguments if not path.is_dir()}
    frames, rejected = [], []
    for i, path in enumerate(paths):
        tell(i)
        must = path.resolve() in named
        frame = read_or_reason(path, kind, named=must)
        if isinstance(frame, Frame) and frame.kind not in MIXTURES[kind] | {"unknown"}:
            frame = BadInput(SWAPPED.format(stated=frame.kind), file=path, mend="correct the frame's kind, or leave it out")
            if must:
                raise frame
        if isinstance(frame, BadInput):
            rejected.append((str(path), frame.what))
        else:
            frames.append(frame)
    if not frames:
        raise BadInput("no frame could be used:" + "".join(f"\n  {file}: {why}" for file, why in rejected))
    return check_series(frames), rejected
