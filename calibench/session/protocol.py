"""Protocol: a lab session as TOML, checked as a whole; all mistakes are reported at once, each with its path."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path, PurePosixPath
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from .. import registry
from ..errors import BadInput, SeveralProblems
from ..records import Camera, Limit

LARGEST_BYTES = 256 * 1024
SCHEMA = 1


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class About(_Table):
    """[protocol]: schema version, name, and what the session is for."""

    schema_: Literal[1] = Field(alias="schema")
    name: str = Field(min_length=1)
    why: str = ""


class CameraTable(_Table):
    """[camera]: who it is."""

    name: str = ""
    serial: str = ""
    sensor: str = ""
    lens: str = ""
    pixel_size_um: float | None = Field(default=None, gt=0)


class Shot(_Table):
    """[[shot]]: one folder of frames. exposures: how many different ones are wanted. with: other shots whose frames the
    measurement needs as well."""

    name: str = Field(min_length=1)
    folder: str
    kind: Literal["dark", "flat", "light"]
    frames: int = Field(ge=1, le=100_000)
    exposures: int = Field(default=1, ge=1)
    measure: str | None = None
    with_: tuple[str, ...] = Field(default=(), alias="with")
    optional: bool = False
    what: str = ""
    why: str = ""

    @field_validator("folder")
    @classmethod
    def _stays_inside(cls, folder: str) -> str:
        path = PurePosixPath(folder.replace("\\", "/"))
        if path.is_absolute() or ".." in path.parts or ":" in folder:
            raise ValueError("must be a folder inside the session")
        return folder

    @field_validator("measure")
    @classmethod
    def _is_known(cls, name: str | None) -> str | None:
        known = registry.names("calibench.measure")
        if name is not None and name not in known:
            raise ValueError(f"no measurement '{name}'; known: {', '.join(known)}")
        return name


class LimitTable(_Table):
    """[[limit]]: what is good enough, and why."""

    measurement: str
    quantity: str
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    why: str = Field(min_length=1)

    @model_validator(mode="after")
    def _bounds(self) -> LimitTable:
        if self.minimum is None and self.maximum is None:
            raise ValueError("needs a minimum, a maximum, or both")
        if self.minimum is not None and self.maximum is not None and self.minimum > self.maximum:
            raise ValueError(f"minimum {self.minimum:g} is above maximum {self.maximum:g}")
        return self


class SolveTable(_Table):
    """[solve]: which methods the sky wing uses."""

    detector: str = "scan"
    centroid: str = "psf_map"
    identify: str = "pattern"
    attitude: str = "quest"
    false_alarms: float = Field(default=1.0, gt=0, lt=1e6)
    k_sigma: float | None = Field(default=None, gt=1, lt=100)

    @field_validator("detector", "centroid", "identify", "attitude")
    @classmethod
    def _is_known(cls, name: str, info: object) -> str:
        folder = {"detector": "spots.detect", "centroid": "spots.centroid", "identify": "stars.identify",
                  "attitude": "stars.attitude"}[info.field_name]
        known = registry.names(f"calibench.{folder}")
        if name not in known:
            raise ValueError(f"no '{name}'; known: {', '.join(known)}")
        return name


class Protocol(_Table):
    """The whole file. measure: settings of each measurement by its name."""

    protocol: About
    camera: CameraTable = CameraTable()
    shot: tuple[Shot, ...] = Field(min_length=1)
    measure: dict[str, dict] = {}
    limit: tuple[LimitTable, ...] = ()
    solve: SolveTable = SolveTable()

    @property
    def limits(self) -> tuple[Limit, ...]:
        return tuple(Limit(**table.model_dump()) for table in self.limit)

    @property
    def camera_record(self) -> Camera:
        return Camera(**self.camera.model_dump())


def load_protocol(path: Path) -> tuple[Protocol, str]:
    """A protocol and the sha256 of its file.

    Raises:
        BadInput: missing, too large, or not TOML. SeveralProblems: everything else that is wrong, at once.
    """
    try:
        raw = path.read_bytes()
        if len(raw) > LARGEST_BYTES:
            raise BadInput(f"{len(raw)} bytes are too many for a protocol", file=path, mend=f"keep it below {LARGEST_BYTES}")
        tables = tomllib.loads(raw.decode("utf-8"))
    except OSError as fault:
        raise BadInput(f"cannot be read: {fault.strerror}", file=path,
                       mend="make a session with: calibench new DIR") from fault
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise BadInput(f"not a TOML file: {fault}", file=path) from fault
    try:
        protocol = Protocol.model_validate(tables)
    except ValidationError as fault:
        raise SeveralProblems([(_place(e["loc"]), _said(e)) for e in fault.errors()], file=path) from fault
    problems = _cross_check(protocol)
    if problems:
        raise SeveralProblems(problems, file=path)
    return protocol, hashlib.sha256(raw).hexdigest()


def _like(default: object, value: object) -> bool:
    """Whether a TOML value can stand for a setting with this default."""
    if isinstance(default, tuple):
        return isinstance(value, list) and len(value) == len(default) and all(map(_like, default, value))
    if isinstance(default, float):
        return isinstance(value, int | float) and not isinstance(value, bool)
    return default is None or isinstance(value, type(default))


def _place(where: tuple) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in where).lstrip(".") or "(file)"


def _said(error: dict) -> str:
    if error["type"] == "extra_forbidden":
        return "is no known key"
    if error["type"] == "missing":
        return "is missing"
    got = "" if isinstance(error["input"], dict) else f" (got {error['input']!r})"
    return error["msg"].removeprefix("Value error, ") + got


def _cross_check(protocol: Protocol) -> list[tuple[str, str]]:
    """What one table says of another."""
    problems = []
    names = [shot.name for shot in protocol.shot]
    measured = {shot.measure for shot in protocol.shot if shot.measure}
    for i, shot in enumerate(protocol.shot):
        if names.index(shot.name) != i:
            problems.append((f"shot[{i}].name", f"'{shot.name}' is used twice"))
        problems += [(f"shot[{i}].with", f"there is no shot '{other}'") for other in shot.with_ if other not in names]
    for name, settings in protocol.measure.items():
        if name not in registry.names("calibench.measure"):
            known = ", ".join(registry.names("calibench.measure"))
            problems.append((f"measure.{name}", f"no such measurement; known: {known}"))
            continue
        fields = registry.load("calibench.measure", name).Settings.__dataclass_fields__
        problems += [(f"measure.{name}.{key}", f"is no setting; known: {', '.join(fields)}")
                     for key in settings if key not in fields]
        problems += [(f"measure.{name}.{key}", f"should be like {fields[key].default!r}, not {value!r}")
                     for key, value in settings.items() if key in fields and not _like(fields[key].default, value)]
    problems += [(f"limit[{i}].measurement", f"no shot is measured by '{limit.measurement}'")
                 for i, limit in enumerate(protocol.limit) if limit.measurement not in measured]
    return problems
