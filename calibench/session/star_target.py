"""The sky as a calibration target: solved frames handed to the bench wing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..records import Measurement, Provenance
from .measuring import NO_SETTINGS, measure
from .sky import SolvedFrame


def star_lens(solved: Sequence[SolvedFrame], settings: Mapping[str, object] = NO_SETTINGS) -> Measurement:
    """The lens from the identified stars of many frames; which frames they were stays with the measurement.

    Raises:
        BadInput: too few frames were solved, or they are not of one camera.
    """
    measurement = measure("star_lens", [one.solution.identification for one in solved], None, settings)
    frames = [one.frame for one in solved if one.frame is not None]
    cameras = {frame.camera for frame in frames if frame.camera}
    return replace(measurement, provenance=Provenance(
        inputs={frame.label: frame.sha256 for frame in frames}, settings=measurement.provenance.settings,
        conditions={"camera": ", ".join(sorted(cameras)) or None}))
