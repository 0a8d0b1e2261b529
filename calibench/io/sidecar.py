"""Sidecar: the TOML text beside a frame that says what its file cannot.

`<frame file name>.toml` speaks of one frame; `frames.toml` of a whole folder: a [default] table and [files."name"] tables.
The default yields to the tables; tables that contradict each other or a header do not (see `metadata.merge`).
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

from ..errors import BadInput, SeveralProblems
from .metadata import BAYER_PATTERNS, FrameMetadata, kind_of, merge, utc
from .station import station_of

FOLDER_SIDECAR = "frames.toml"
MAX_BYTES = 1_000_000
LAYOUT_KEYS = ("width", "height", "dtype", "endianness", "packing", "offset_bytes")
ROW_KEYS = ("exposure_rows", "row_time_s", "overhead_s")
PACKINGS = ("none", "mipi10", "mipi12", "mono10p", "mono12p", "mono12packed")


@dataclass(frozen=True, kw_only=True)
class Sidecar:
    """What the sidecars of one frame say: `metadata`, and for headerless files the `layout` by its sidecar keys."""

    source: str = ""
    metadata: FrameMetadata = field(default_factory=FrameMetadata)
    layout: Mapping[str, object] = field(default_factory=lambda: MappingProxyType({}))


def sidecar_of(frame: Path) -> Sidecar:
    """The sidecar of a frame file; an empty one where there is none.

    Raises:
        BadInput: a sidecar is too large, no TOML, or holds mistakes (all are listed), or two tables contradict each other.
    """
    own_path, folder_path = frame.with_name(frame.name + ".toml"), frame.with_name(FOLDER_SIDECAR)
    own = _tables(own_path, None) if own_path.is_file() else {}
    default, by_file = {}, {}
    if folder_path.is_file():
        folder = _tables(folder_path, FOLDER_SIDECAR)
        default, by_file = folder.get("default", {}), folder.get("files", {}).get(frame.name, {})
    if not (own or default or by_file):
        return Sidecar()
    merge([(own_path.name, _metadata(own)), (FOLDER_SIDECAR, _metadata(by_file))], file=frame)
    said = {**default, **by_file, **own}
    if {"exposure_s", "exposure_rows"} & set(own | by_file):
        # A frame's own exposure replaces the default one, in whichever of the two forms either is given.
        said = {key: value for key, value in said.items()
                if key in own or key in by_file or key not in ("exposure_s", "exposure_rows")}
    _check_rows(said, frame)
    names = [name for name, table in ((own_path.name, own), (FOLDER_SIDECAR, default or by_file)) if table]
    layout = {key: said[key] for key in LAYOUT_KEYS if key in said}
    return Sidecar(source=" and ".join(names), metadata=_metadata(said), layout=MappingProxyType(layout))


def exposure_from_rows(rows: float, row_time_s: float, overhead_s: float = 0.0) -> float:
    """Exposure of a rolling or row-timed shutter set in rows: t = rows * row_time + overhead, seconds."""
    return rows * row_time_s + overhead_s


def _metadata(said: Mapping[str, object]) -> FrameMetadata:
    values = {key: value for key, value in said.items() if key in FrameMetadata.__dataclass_fields__}
    if "exposure_rows" in said and "row_time_s" in said and "exposure_s" not in said:
        values["exposure_s"] = exposure_from_rows(said["exposure_rows"], said["row_time_s"], said.get("overhead_s", 0.0))
    if "station" in values:
        values["station"] = station_of(values["station"])
    if "chief_rays_px" in values:
        values["chief_rays_px"] = tuple(tuple(place) for place in values["chief_rays_px"])
    if "kind" in values:
        values["kind"] = kind_of(values["kind"])
    if "bayer_pattern" in values:
        values["bayer_pattern"] = values["bayer_pattern"].upper()
    return FrameMetadata(**values)


def _check_rows(said: Mapping[str, object], frame: Path) -> None:
    if "exposure_rows" not in said:
        return
    if "row_time_s" not in said:
        raise BadInput("its sidecar gives exposure_rows without row_time_s", file=frame,
                       mend="add row_time_s, the time of one row in seconds (and overhead_s where the camera adds one)")
    from_rows = exposure_from_rows(said["exposure_rows"], said["row_time_s"], said.get("overhead_s", 0.0))
    stated = FrameMetadata(exposure_s=said.get("exposure_s"))
    merge([("exposure_s", stated), ("exposure_rows", FrameMetadata(exposure_s=from_rows))], file=frame)


def _tables(path: Path, folder_sidecar: str | None) -> Mapping:
    """The checked content of one sidecar file. A folder's sidecar is parsed once, not once a frame."""
    stat = path.stat()
    if stat.st_size > MAX_BYTES:
        raise BadInput(f"{stat.st_size} bytes are too many for a sidecar (limit {MAX_BYTES})", file=path,
                       mend="a sidecar holds a few keys a frame; keep data elsewhere")
    return _parse(path, stat.st_mtime_ns, stat.st_size, folder_sidecar)


@lru_cache(maxsize=8)
def _parse(path: Path, mtime_ns: int, size: int, folder_sidecar: str | None) -> Mapping:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, OSError) as error:
        raise BadInput(f"no readable TOML: {error}", file=path, mend="a line reads: exposure_s = 0.01") from error
    problems: list[tuple[str, str]] = []
    if folder_sidecar is None:
        _check(content, "", problems)
    else:
        for name in content.keys() - {"default", "files"}:
            problems.append((name, 'unknown table; known are [default] and [files."name"]'))
        _check(content.get("default", {}), "default.", problems)
        files = content.get("files", {})
        if not isinstance(files, dict):
            problems.append(("files", 'must be tables, one a frame: [files."name"]'))
        else:
            for name, table in files.items():
                _check(table, f'files."{name}".', problems)
    if problems:
        raise SeveralProblems(sorted(problems), file=path, mend=f"known keys: {', '.join(sorted(_RULES))}")
    return content


def _check(table: object, where: str, problems: list[tuple[str, str]]) -> None:
    if not isinstance(table, dict):
        problems.append((where.rstrip("."), "must be a table of keys"))
        return
    for key, value in table.items():
        if key not in _RULES:
            problems.append((where + key, "unknown key"))
        else:
            holds, wanted = _RULES[key]
            if not holds(value):
                problems.append((where + key, f"{value!r} is not {wanted}"))
            elif key == "station":
                problems += [(where + key, what) for what in _station_mistakes(value)]


def _station_mistakes(table: Mapping) -> list[str]:
    try:
        station_of(table)
    except BadInput as fault:
        return [fault.what.removeprefix("station: ")]
    return []


def _number(minimum: float = -math.inf, *, above: bool = False) -> Callable[[object], bool]:
    def holds(value: object) -> bool:
        numeric = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        return numeric and (value > minimum if above else value >= minimum)
    return holds


def _integer(minimum: int, maximum: int) -> Callable[[object], bool]:
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and minimum <= value <= maximum


def _one_of(*known: str) -> tuple[Callable[[object], bool], str]:
    return (lambda value: value in known), "one of " + ", ".join(known)


def _are_places(value: object) -> bool:
    number = _number()
    return isinstance(value, list) and all(isinstance(place, list) and len(place) == 2 and all(map(number, place))
                                           for place in value)


def _is_date(value: object) -> bool:
    try:
        utc(value)
    except (TypeError, ValueError):
        return False
    return True


_POSITIVE = (_number(0, above=True), "a positive number")
_NOT_NEGATIVE = (_number(0), "a number of at least 0")
_ANY_NUMBER = (_number(), "a number")
_TEXT = ((lambda value: isinstance(value, str) and len(value) <= 200), "a text of at most 200 characters")
_PIXELS = (_integer(1, 200_000), "a whole number of pixels, 1 to 200000")
_RULES: dict[str, tuple[Callable[[object], bool], str]] = {
    "exposure_s": _NOT_NEGATIVE, "exposure_rows": _NOT_NEGATIVE, "row_time_s": _POSITIVE, "overhead_s": _ANY_NUMBER,
    "gain_setting": _ANY_NUMBER, "egain_e_per_dn": _POSITIVE,
    "temperature_c": (_number(-273.15), "a temperature in degrees Celsius"),
    "kind": ((lambda value: isinstance(value, str) and kind_of(value) is not None), "one of dark, flat, light"),
    "bayer_pattern": ((lambda value: isinstance(value, str) and value.upper() in BAYER_PATTERNS),
                      "one of " + ", ".join(BAYER_PATTERNS)),
    "station": ((lambda value: isinstance(value, dict)), "a table: [station] with its own keys"),
    "date_obs": (_is_date, "an ISO 8601 date in quotes, UTC"), "camera": _TEXT,
    "bit_depth": (_integer(1, 16), "a whole number of bits, 1 to 16"),
    "black_level_dn": _ANY_NUMBER, "white_level_dn": _POSITIVE, "pixel_size_um": _POSITIVE, "photons_per_px": _NOT_NEGATIVE,
    "focus_um": _ANY_NUMBER, "chief_rays_px": (_are_places, "a list of places [x, y]"),
    "width": _PIXELS, "height": _PIXELS, "offset_bytes": (_integer(0, 2**40), "a whole number of bytes, at least 0"),
    "dtype": _one_of("uint8", "uint16", "float32"), "endianness": _one_of("little", "big"),
    "packing": _one_of(*PACKINGS), "alignment": _one_of("left", "right"),
}
