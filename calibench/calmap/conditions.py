"""Under which conditions a map was measured, and whether a frame was taken within them."""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Mapping, Sequence
from typing import TypeVar

from ..errors import BadInput
from ..records import CalibrationMap, Camera, Conditions, Frame, Measurement

# An exposure this far beyond the darks, relative, still counts as inside: cameras round what they are asked for.
EXPOSURE_MARGIN = 0.05
# Dark current doubles about every 6-8 K, so 2 K changes it by a fifth: as much as a dark layer tolerates unseen.
TEMPERATURE_MARGIN_C = 2.0

Value = TypeVar("Value", bound=Hashable)


def agreed(what: str, stated: Mapping[str, Value | None]) -> Value | None:
    """The one value that all sources state; None where none does.

    Raises:
        BadInput: two sources contradict each other; the message lists who says what.
    """
    said = {source: value for source, value in stated.items() if value is not None}
    if len(set(said.values())) > 1:
        raise BadInput(f"{what} contradict: " + ", ".join(f"{source} has {value}" for source, value in said.items()),
                       mend="one map holds one camera at one setting: measure all at the same one, or start a new map")
    return next(iter(said.values()), None)


def merge_cameras(first: Camera, second: Camera) -> Camera:
    """One identity of two, field by field; an empty field states nothing.

    Raises:
        BadInput: the two are different cameras.
    """
    return Camera(**{
        field.name: agreed(f"camera identities ({field.name})", {
            "the base map": getattr(first, field.name) or None, "this session": getattr(second, field.name) or None,
        }) or field.default
        for field in dataclasses.fields(Camera)})


def merge_conditions(measurements: Sequence[Measurement], base: CalibrationMap | None) -> Conditions:
    """The span of exposure, temperature and date over all, and the one gain setting, bit depth and camera.

    Measurements of geometry alone do not speak of bit depth: board views may be 8-bit where darks are 12-bit.

    Raises:
        BadInput: gain settings, bit depths or cameras contradict.
    """
    stated = {"the base map": dataclasses.asdict(base.conditions)} if base else {}
    stated |= {m.name: dict(m.provenance.conditions) for m in measurements}
    geometry_only = {m.name for m in measurements if not m.maps and not m.layers}

    def span(key: str) -> tuple | None:
        ranges = [conditions[key] for conditions in stated.values() if conditions.get(key) is not None]
        return (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None

    return Conditions(
        exposure_s=span("exposure_s"), temperature_c=span("temperature_c"), date_obs=span("date_obs"),
        camera=agreed("cameras", {name: c.get("camera") for name, c in stated.items()}),
        gain_setting=agreed("gain settings", {name: c.get("gain_setting") for name, c in stated.items()}),
        bit_depth=agreed("bit depths", {name: c.get("bit_depth") for name, c in stated.items()
                                        if name not in geometry_only}))


def outside_conditions(frame: Frame, calmap: CalibrationMap) -> tuple[str, ...]:
    """One sentence for each condition of the map that the frame contradicts; empty where it fits.

    Exposure (EXPOSURE_MARGIN beyond the range) and temperature (TEMPERATURE_MARGIN_C beyond) are judged only where the
    map has a dark layer, because nothing else in it depends on them. What a frame or a map does not state is no
    contradiction: see `unchecked_conditions`. The image size is `correct`'s to refuse.
    """
    conditions, sentences = calmap.conditions, []
    if _has_dark(calmap):
        for what, value, span, unit, margins in (
            ("exposure", frame.exposure_s, conditions.exposure_s, "s", _exposure_margins(conditions)),
            ("temperature", frame.temperature_c, conditions.temperature_c, "C", (TEMPERATURE_MARGIN_C,) * 2),
        ):
            if value is not None and span is not None and not span[0] - margins[0] <= value <= span[1] + margins[1]:
                sentences.append(f"{what} {value:g} {unit} is outside the map's {span[0]:g} to {span[1]:g} {unit}")
    if None not in (frame.gain_setting, conditions.gain_setting) and frame.gain_setting != conditions.gain_setting:
        sentences.append(f"gain setting {frame.gain_setting:g} is not the map's {conditions.gain_setting:g}")
    depth = conditions.bit_depth
    if depth is not None and not frame.range_assumed and frame.bit_depth != depth:
        sentences.append(f"{frame.bit_depth} bits a pixel are not the map's {depth}: its DN are of another size")
    known_as = _known_as(calmap)
    if frame.camera and known_as and frame.camera.strip().casefold() not in map(str.casefold, known_as):
        sentences.append(f"camera '{frame.camera}' is not the map's: {', '.join(known_as)}")
    return tuple(sentences)


def unchecked_conditions(frame: Frame, calmap: CalibrationMap) -> tuple[str, ...]:
    """One sentence for each condition that could not be compared, because the frame or the map does not state it."""
    conditions, sentences = calmap.conditions, []
    if not calmap.measured:
        return ()
    if not frame.camera or not _known_as(calmap):
        silent = "the map" if frame.camera else "the frame"
        sentences.append(f"{silent} does not say which camera it belongs to: the identity was not checked")
    if conditions.gain_setting is not None and frame.gain_setting is None:
        sentences.append(f"the frame states no gain setting: the map's {conditions.gain_setting:g} was not checked")
    if _has_dark(calmap) and conditions.temperature_c is not None and frame.temperature_c is None:
        low, high = conditions.temperature_c
        sentences.append(f"the frame states no temperature: the map's {low:g} to {high:g} C was not checked")
    return tuple(sentences)


def _has_dark(calmap: CalibrationMap) -> bool:
    return not calmap.measured.isdisjoint(("offset_dn", "dark_rate_dn_per_s"))


def _exposure_margins(conditions: Conditions) -> tuple[float, float]:
    low, high = conditions.exposure_s or (0.0, 0.0)
    return EXPOSURE_MARGIN * low, EXPOSURE_MARGIN * high


def _known_as(calmap: CalibrationMap) -> list[str]:
    """The texts by which a frame may name the map's camera."""
    return [text.strip() for text in (calmap.conditions.camera, calmap.camera.name, calmap.camera.serial) if text]
