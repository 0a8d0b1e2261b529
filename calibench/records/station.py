"""Station: what a frame's date alone does not tell of how it was taken: place or velocity, air, shutter, rate."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import BadInput

REFRACTIONS = ("erfa", "bennett")
READOUTS = ("down", "up")


@dataclass(frozen=True, kw_only=True)
class Station:
    """None: not known, and left out.

    latitude_rad, longitude_rad (east positive), height_m: geodetic place on WGS 84, for a camera on the ground.
    velocity_km_s: velocity about the Earth's centre, GCRS axes, for a camera in orbit.
    refraction: by which formula the air bends light (REFRACTIONS), for pressure_hpa at the camera, air_temperature_c, humidity
    (0 to 1), wavelength_um.
    row_time_s: a rolling shutter's time from row to row; readout: which way the rows follow each other (READOUTS).
    rate_rad_s: how fast the camera turns, about its own axes x, y, z.
    """

    latitude_rad: float | None = None
    longitude_rad: float | None = None
    height_m: float = 0.0
    velocity_km_s: tuple[float, float, float] | None = None
    refraction: str | None = None
    pressure_hpa: float = 1013.25
    air_temperature_c: float = 10.0
    humidity: float = 0.5
    wavelength_um: float = 0.55
    row_time_s: float | None = None
    readout: str = "down"
    rate_rad_s: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        placed = self.latitude_rad is not None
        if placed != (self.longitude_rad is not None):
            raise BadInput("a place needs latitude and longitude")
        if placed and self.velocity_km_s is not None:
            raise BadInput("a camera either stands at a place or flies with a velocity", mend="give one of the two")
        if self.refraction is not None and not placed:
            raise BadInput("refraction needs the place: the air bends light towards the zenith",
                           mend="give latitude, longitude and height")
        within = (("latitude", self.latitude_rad, -math.pi / 2, math.pi / 2), ("longitude", self.longitude_rad, -7.0, 7.0),
                  ("height_m", self.height_m, -500, 100_000), ("pressure_hpa", self.pressure_hpa, 0, 1100),
                  ("air_temperature_c", self.air_temperature_c, -100, 100), ("humidity", self.humidity, 0, 1),
                  ("wavelength_um", self.wavelength_um, 0.2, 20), ("row_time_s", self.row_time_s, 1e-9, 1))
        for name, value, low, high in within:
            if value is not None and not low <= value <= high:
                raise BadInput(f"{name} {value:g} is outside {low:g} to {high:g}")
        for name, vector, most in (("velocity_km_s", self.velocity_km_s, 50), ("rate_rad_s", self.rate_rad_s, 10)):
            if vector is not None and not (len(vector) == 3 and math.hypot(*vector) <= most):
                raise BadInput(f"{name} {vector} is no vector of three numbers of length {most:g} or less")
        for name, value, known in (("refraction", self.refraction, (None, *REFRACTIONS)), ("readout", self.readout, READOUTS)):
            if value not in known:
                raise BadInput(f"{name} '{value}' is none of {', '.join(k for k in known if k)}")
