"""SkyCase: one sky frame and, where known, where it really looked. Trial: what a trial found, as a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..geometry import sphere
from ..records import CalibrationMap, Frame, Intrinsics
from ..records.arrays import frozen, settle
from ..stars.solve import Solution

ARCSEC = 180 * 3600 / np.pi


@dataclass(frozen=True, kw_only=True)
class SkyTruth:
    """Sky direction (unit vector, ICRS) of the image's centre, aberration removed, and position angle of image up there."""

    centre_icrs: np.ndarray
    roll_rad: float

    def __post_init__(self) -> None:
        settle(self, centre_icrs=frozen(self.centre_icrs, name="SkyTruth.centre_icrs", shape=(3,), dtype=float))


@dataclass(frozen=True, kw_only=True)
class SkyCase:
    """frame: raw. truth: None where nobody knows."""

    frame: Frame
    truth: SkyTruth | None = None


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A table of figures: columns with their units, rows in order, and one line that says how to read it."""

    name: str
    reading: str
    columns: tuple[str, ...]
    rows: tuple[tuple, ...]


def cross_error_rad(solution: Solution, truth: SkyTruth) -> float:
    """Angle between the solved and the true direction of the image's centre."""
    return float(sphere.angle_between(sphere.unit_from_radec(solution.ra_rad, solution.dec_rad), truth.centre_icrs))


def roll_error_rad(solution: Solution, truth: SkyTruth) -> float:
    """Solved minus true roll, in (-pi, pi]."""
    return float(np.angle(np.exp(1j * (solution.roll_rad - truth.roll_rad))))


def the_lens(calmap: CalibrationMap, who: str) -> Intrinsics:
    """The map's lens.

    Raises:
        BadInput: it has none; who: what needs it.
    """
    if "intrinsics" not in calmap.measured:
        raise BadInput(f"{who} needs the map's lens", mend="measure intrinsics into the map")
    return calmap.intrinsics
