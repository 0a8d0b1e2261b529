"""Station from what a person writes: the [station] table of a sidecar, degrees and kilometres a second."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path

from ..errors import BadInput
from ..records import Station

DEGREES = {"latitude_deg": "latitude_rad", "longitude_deg": "longitude_rad", "rate_deg_s": "rate_rad_s"}
VECTORS = ("velocity_km_s", "rate_deg_s")
TEXTS = ("refraction", "readout")
NUMBERS = ("latitude_deg", "longitude_deg", "height_m", "pressure_hpa", "air_temperature_c", "humidity", "wavelength_um",
           "row_time_s")
STATION_KEYS = (*NUMBERS, *VECTORS, *TEXTS)


def station_of(table: Mapping[str, object], *, file: object = None) -> Station:
    """The station of a table with keys of STATION_KEYS.

    Raises:
        BadInput: an unknown key, a value of another kind or out of range, or a half statement.
    """
    values: dict[str, object] = {}
    for key, value in table.items():
        if key in TEXTS and isinstance(value, str):
            values[key] = value
        elif key in NUMBERS and _is_number(value):
            values[DEGREES.get(key, key)] = math.radians(value) if key in DEGREES else float(value)
        elif key in VECTORS and isinstance(value, (list, tuple)) and len(value) == 3 and all(map(_is_number, value)):
            values[DEGREES.get(key, key)] = tuple(math.radians(v) if key in DEGREES else float(v) for v in value)
        elif key in STATION_KEYS:
            raise BadInput(f"station: {key} = {value!r} is not {_wanted(key)}", file=file)
        else:
            raise BadInput(f"station: unknown key {key}", file=file, mend=f"known keys: {', '.join(STATION_KEYS)}")
    try:
        return Station(**values)
    except BadInput as fault:
        raise BadInput(f"station: {fault.what}", file=file, mend=fault.mend) from fault


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _wanted(key: str) -> str:
    return "a text" if key in TEXTS else "three numbers" if key in VECTORS else "a finite number"


def read_station(text: str) -> Station:
    """The station of a TOML file, by its path, or of keys written out: `latitude_deg = 48.2; longitude_deg = 16.4`.

    Raises:
        BadInput: no such file, no TOML, or as `station_of`.
    """
    written = "=" in text
    file = None if written else Path(text)
    try:
        table = tomllib.loads(text.replace(";", "\n") if written else file.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise BadInput(f"station: {'' if written else 'no readable file: '}{fault}", file=file,
                       mend='write latitude_deg = 48.2; refraction = "erfa", or name a TOML file with such lines') from fault
    return station_of(table.get("station", table), file=file)
