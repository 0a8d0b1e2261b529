"""Measure one thing from frames, and put it into a map."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from types import MappingProxyType

from .. import __version__, registry
from ..calmap.assemble import UNNAMED, assemble
from ..errors import UsageError
from ..records import CalibrationMap, Camera, Frame, Measurement

FOLDER = "calibench.measure"
NO_SETTINGS: Mapping[str, object] = MappingProxyType({})


def settings_of(name: str, given: Mapping[str, object]) -> object:
    """The measurement's own Settings from plain values (lists become tuples).

    Raises:
        UsageError: a setting it does not have.
    """
    settings = registry.load(FOLDER, name).Settings
    known = {f.name for f in fields(settings)}
    unknown = set(given) - known
    if unknown:
        raise UsageError(f"{name} has no setting {', '.join(sorted(unknown))}", mend=f"it has: {', '.join(sorted(known))}")
    return settings(**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items() if v is not None})


def measure(name: str, frames: Iterable[Frame], calmap: CalibrationMap | None,
            settings: Mapping[str, object] = NO_SETTINGS) -> Measurement:
    """Run the named measurement.

    Raises:
        BadInput: what the measurement says of the frames. UsageError: no such measurement or setting.
    """
    return registry.load(FOLDER, name).measure(frames, settings_of(name, settings), calmap)


def into_map(measurements: Sequence[Measurement], base: CalibrationMap | None, camera: Camera = UNNAMED,
             protocol_sha256: str = "") -> CalibrationMap:
    """A map of these measurements on top of `base`, stamped with software and time.

    A camera that the protocol does not name takes the name its frames give.
    """
    named = [m.provenance.conditions.get("camera") for m in measurements if m.provenance.conditions.get("camera")]
    if camera == UNNAMED and named and not (base and base.camera.name):
        camera = Camera(name=named[0])
    return assemble(measurements, base, camera, software=f"calibench {__version__}",
                    created=datetime.now(UTC).isoformat(timespec="seconds"), protocol_sha256=protocol_sha256)
