"""What every export of the lens needs: intrinsics that were measured and that other programs can express."""

from __future__ import annotations

from pathlib import Path

from ...errors import BadInput
from ...records import CalibrationMap, Intrinsics


def measured_lens(calmap: CalibrationMap, path: Path | str) -> Intrinsics:
    """The map's intrinsics.

    Raises:
        BadInput: they were not measured, or are mirrored, which the formats of other programs cannot say.
    """
    if "intrinsics" not in calmap.measured:
        raise BadInput("the map has no intrinsics to export", file=path,
                       mend="add them: calibench intrinsics FRAMES --board 9x6 --square-mm 25 --map MAP --map-out MAP")
    if calmap.intrinsics.mirrored:
        raise BadInput("the map's intrinsics are mirrored, and this format has no word for it", file=path,
                       mend="flip the frames when they are read out, and measure the intrinsics on those")
    return calmap.intrinsics
