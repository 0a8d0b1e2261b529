"""Observer: when a frame was taken, how fast the camera moved, through what air it looked, how its rows were read."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .arrays import frozen, settle


@dataclass(frozen=True, kw_only=True)
class Refraction:
    """How the air bends light towards the zenith.

    zenith_icrs: (3,) unit vector in ICRS axes. model: "erfa", dz = A tan z + B tan^3 z with constants_rad = (A, B); or
    "bennett", Bennett's formula with constants_rad[0], one arcmin times the factor of pressure and temperature.
    """

    zenith_icrs: np.ndarray
    model: str
    constants_rad: tuple[float, float]

    def __post_init__(self) -> None:
        settle(self, zenith_icrs=frozen(self.zenith_icrs, name="Refraction.zenith_icrs", shape=(3,), dtype=float))


@dataclass(frozen=True, kw_only=True)
class Rolling:
    """A rolling shutter on a turning camera: row r is exposed (r - middle_row) * row_time_s after the time tag.

    row_time_s: negative where the rows are read upwards. rate_rad_s: (3,) turning rate about the camera's own axes; zero
    where it is not known (a track knows its own).
    """

    row_time_s: float
    middle_row: float
    rate_rad_s: np.ndarray

    def __post_init__(self) -> None:
        settle(self, rate_rad_s=frozen(self.rate_rad_s, name="Rolling.rate_rad_s", shape=(3,), dtype=float))


@dataclass(frozen=True, kw_only=True)
class Observer:
    """Star positions are wanted at `epoch_jyear`, seen from a place moving at velocity_c.

    velocity_c: (3,) barycentric velocity in units of the speed of light, ICRS axes; zero where no date is known.
    position_au: (3,) barycentric position, for parallax. time_utc: the time tag, ISO 8601 (mid-exposure where the exposure is
    known); empty where undated. refraction, rolling: None where there is none.
    """

    epoch_jyear: float = 2000.0
    velocity_c: np.ndarray = field(default_factory=lambda: np.zeros(3))
    position_au: np.ndarray = field(default_factory=lambda: np.zeros(3))
    dated: bool = False
    time_utc: str = ""
    refraction: Refraction | None = None
    rolling: Rolling | None = None

    def __post_init__(self) -> None:
        settle(self, velocity_c=frozen(self.velocity_c, name="Observer.velocity_c", shape=(3,), dtype=float),
               position_au=frozen(self.position_au, name="Observer.position_au", shape=(3,), dtype=float))
