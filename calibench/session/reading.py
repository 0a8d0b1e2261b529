"""Frames for one measurement, from files and folders named by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import BadInput, Contradiction
from ..io.frames import read_frame
from ..io.series_checks import check_series
from ..records import Frame

MIXTURES = {"dark": {"dark"}, "flat": {"flat", "dark"}, "light": {"light"}}
SWAPPED = "states that it is a {stated} frame, which this measurement does not take: are the folders swapped?"


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
        try:
            frame = read_frame(path, kind)
            if frame.kind not in MIXTURES[kind] | {"unknown"}:
                raise BadInput(SWAPPED.format(stated=frame.kind), file=path, mend="correct the frame's kind, or leave it out")
            frames.append(frame)
        except BadInput as fault:
            if path.resolve() in named or isinstance(fault, Contradiction):
                raise
            rejected.append((str(path), fault.what))
    if not frames:
        raise BadInput("no frame could be used:" + "".join(f"\n  {file}: {why}" for file, why in rejected))
    return check_series(frames), rejected
