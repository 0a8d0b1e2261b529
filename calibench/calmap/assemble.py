"""Measurements to one calibration map, and a map without one of its layers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..errors import BadInput
from ..records import CURVE_LAYERS, DEFECT_FLAGS, IMAGE_LAYERS, LAYERS, CalibrationMap, Camera, Measurement
from .clusters import with_clusters
from .conditions import agreed, merge_cameras, merge_conditions

# Layers that are measured together and mean something only together: an offset taken without a known exposure holds
# dark charge, so it must never meet the dark rate of another session.
LAYER_GROUPS: dict[str, tuple[str, ...]] = {
    "dark": ("offset_dn", "offset_uncertainty_dn", "dark_rate_dn_per_s", "dark_rate_uncertainty_dn_per_s", "dark_reference_c",
             "dark_activation_ev"),
    "response": ("response", "response_uncertainty", "illumination"),
    "read_noise": ("read_noise_dn",),
    "defects": ("defects",),
    "gain": ("gain_dn_per_e",),
    "saturation": ("saturation_dn",),
    "linearity": ("linearity_dn",),
    "intrinsics": ("intrinsics",),
    "psf": ("psf",),
}
UNNAMED = Camera()


def assemble(measurements: Sequence[Measurement], base: CalibrationMap | None = None, camera: Camera = UNNAMED, *,
             software: str, created: str, protocol_sha256: str = "") -> CalibrationMap:
    """One map of all measurements, on top of a copy of `base`.

    Layers replace those of the base by whole groups (LAYER_GROUPS); where two measurements bring the same layer, the
    later one counts and a warning says so. Defects are OR-ed: a flag that the base carries stays. A scalar layer that
    is not finite counts as not measured, and so does an uncertainty without a finite pixel; elsewhere a pixel that is
    not finite takes its layer's median and the flag `unmeasured`.

    Quantities are named "measurement.quantity", evidence "measurement/array", inputs "measurement/file", settings by
    measurement; warnings begin with "measurement: ". What the base holds of a measurement that is made anew is
    dropped, its verdicts too. Conditions become the span of all: with a base they never narrow.

    created: ISO 8601 text, handed in so that the same input gives the same map.

    Raises:
        BadInput: nothing to assemble, two measurements of one name, an unknown layer, a layer without a single finite
            pixel, or a contradiction in image size, gain setting, bit depth or camera.
    """
    names = [m.name for m in measurements]
    if len(set(names)) < len(names):
        raise BadInput(f"two measurements have the same name: {', '.join(names)}", mend="hand in each one once")
    sources = ({"the base map": base} if base else {}) | {m.name: m for m in measurements}
    size = agreed("image sizes", {name: tuple(source.image_size_px) for name, source in sources.items()})
    if size is None:
        raise BadInput("there is nothing to put into a map", mend="hand in at least one measurement")

    layers, warnings = _layers(measurements, base)
    warnings = [*warnings, *_made_too_early(measurements, base)]
    return CalibrationMap(
        image_size_px=size, measured=frozenset(layers), **layers,
        camera=merge_cameras(base.camera if base else UNNAMED, camera),
        conditions=merge_conditions(measurements, base),
        quantities=_kept(base, "quantities", names)
        | {f"{m.name}.{quantity.name}": quantity for m in measurements for quantity in m.quantities},
        evidence=_kept(base, "evidence", names)
        | {f"{m.name}/{name}": array for m in measurements for name, array in m.evidence.items()},
        inputs=_kept(base, "inputs", names)
        | {f"{m.name}/{file}": sha256 for m in measurements for file, sha256 in m.provenance.inputs.items()},
        settings=_kept(base, "settings", names) | {m.name: dict(m.provenance.settings) for m in measurements},
        verdicts=tuple(v for v in (base.verdicts if base else ()) if v.limit.measurement not in names),
        warnings=tuple(w for w in (base.warnings if base else ()) if w.partition(": ")[0] not in names)
        + tuple(f"{m.name}: {w}" for m in measurements for w in m.warnings) + tuple(warnings),
        protocol_sha256=protocol_sha256 or (base.protocol_sha256 if base else ""),
        software=software, created=created)


def _made_too_early(measurements: Sequence[Measurement], base: CalibrationMap | None) -> list[str]:
    """Figures of the base that a gain measured now could have turned into electrons."""
    early = base is not None and "dark.read_noise_e" in base.quantities and base.quantities["dark.read_noise_e"].value is None
    if early and any("gain_dn_per_e" in m.layers for m in measurements) and all(m.name != "dark" for m in measurements):
        return ["dark: its figures in e- and its limit of hot pixels were made before the gain was known: "
                "run dark again with this map"]
    return []


def without_layer(calmap: CalibrationMap, layer: str) -> CalibrationMap:
    """The map with one group of LAYER_GROUPS at its identity, as if never measured; the rest is unchanged.

    Raises:
        BadInput: no such group.
    """
    if layer not in LAYER_GROUPS:
        raise BadInput(f"a map has no layer group '{layer}'", mend=f"choose one of: {', '.join(LAYER_GROUPS)}")
    removed = LAYER_GROUPS[layer]
    identity = CalibrationMap(image_size_px=calmap.image_size_px)
    return dataclasses.replace(calmap, measured=calmap.measured - set(removed),
                               **{name: getattr(identity, name) for name in removed})


def _layers(measurements: Sequence[Measurement], base: CalibrationMap | None) -> tuple[dict[str, object], list[str]]:
    """The layers of the new map by name, and what has to be said about them."""
    old = {name: getattr(base, name) for name in base.measured} if base else {}
    new: dict[str, object] = {}
    defects = [old.pop("defects")] if "defects" in old else []
    warnings: list[str] = []
    for measurement in measurements:
        for name, value in _brought(measurement).items():
            if name == "defects":
                defects.append(np.asarray(value, dtype=np.uint16))
                continue
            if name in new:
                warnings.append(f"{measurement.name}: its layer {name} replaces that of a measurement before it")
            if "uncertainty" in name and not np.isfinite(value).any():
                warnings.append(f"{measurement.name}: its {name} is unknown and was left out")
                continue
            if name in IMAGE_LAYERS:
                value, unmeasured = _filled(value, f"layer {name} of {measurement.name}")
                if unmeasured.any():
                    defects.append(unmeasured * np.uint16(DEFECT_FLAGS["unmeasured"]))
                    warnings.append(f"{measurement.name}: {np.count_nonzero(unmeasured)} pixels of {name} are not "
                                    "finite; they take the layer's median and the flag 'unmeasured'")
            new[name] = value

    replaced = {name for group in LAYER_GROUPS.values() if not new.keys().isdisjoint(group) for name in group}
    layers = {name: value for name, value in old.items() if name not in replaced} | new
    if defects:
        layers["defects"] = with_clusters(np.bitwise_or.reduce(defects))
    return layers, warnings


def _brought(measurement: Measurement) -> dict[str, object]:
    """Every layer that a measurement brings, by its CalibrationMap name."""
    small = {name: value if name in CURVE_LAYERS else float(value) for name, value in measurement.layers.items()
             if np.isfinite(value).all()}
    models = {name: getattr(measurement, name) for name in ("intrinsics", "psf")}
    brought = {**measurement.maps, **small, **{name: model for name, model in models.items() if model is not None}}
    unknown = sorted(brought.keys() - set(LAYERS))
    if unknown:
        raise BadInput(f"{measurement.name} brings unknown map layers: {', '.join(unknown)}",
                       mend=f"known layers: {', '.join(LAYERS)}")
    w, h = measurement.image_size_px
    for name, value in measurement.maps.items():
        if np.shape(value) != (h, w):
            raise BadInput(f"layer {name} of {measurement.name} has shape {np.shape(value)}, expected {(h, w)}")
    return brought


def _filled(layer: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float32 without gaps, and where they were. The identity would stand out of an offset like a star; the
    median does not."""
    layer = np.asarray(layer, dtype=np.float32)
    gaps = ~np.isfinite(layer)
    if gaps.all():
        raise BadInput(f"{name} has no finite pixel", mend="leave a layer out that was not measured")
    return (np.where(gaps, np.median(layer[~gaps]), layer) if gaps.any() else layer), gaps


def _kept(base: CalibrationMap | None, field: str, remeasured: Sequence[str]) -> dict:
    """A mapping of the base without the entries of measurements made anew (a key begins with its measurement)."""
    if base is None:
        return {}
    return {key: value for key, value in getattr(base, field).items()
            if not any(key == name or key.startswith((f"{name}.", f"{name}/")) for name in remeasured)}
