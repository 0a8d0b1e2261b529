"""The difference of two maps as plain JSON values, and as text for a person."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np

from ..calmap.compare import MapDifference
from ..calmap.compare_lens import LensDifference
from ..records import CalibrationMap, Intrinsics
from .output import number, table

ARCSEC = 3600 * 180 / math.pi


def difference_json(difference: MapDifference, a: CalibrationMap, b: CalibrationMap) -> dict:
    """Everything that differs, B minus A; pixels, arcsec and the layers' own units. null: unknown."""
    lens = difference.lens
    return {"image_size_px": list(a.image_size_px),
            "intrinsics": None if lens is None else _lens(lens) | {"parameters": _parameters(a.intrinsics, b.intrinsics)},
            "layers": {layer.name: _without_name(layer) for layer in difference.layers},
            "defects": {defect.name: _without_name(defect) for defect in difference.defects},
            "only_in_a": list(difference.only_in_a), "only_in_b": list(difference.only_in_b)}


def difference_text(values: dict) -> str:
    """The same for a person, with the lens by tables and the field left to --json."""
    return "\n\n".join(_paragraphs(values))


def _lens(lens: LensDifference) -> dict:
    length = np.hypot(*lens.shift_px.T)
    field = zip(lens.xy_px.tolist(), lens.shift_px.tolist(), (lens.angle_rad * ARCSEC).tolist(), strict=True)
    return {"rms_px": lens.rms_px, "largest_px": float(length.max()),
            "expected_rms_px": _finite(lens.expected_rms_px),
            "rms_arcsec": lens.rms_rad * ARCSEC, "largest_arcsec": float(lens.angle_rad.max() * ARCSEC),
            "rotation_removed_arcsec": (lens.rotation_rad * ARCSEC).tolist(), "points_fitted": int(lens.inside.sum()),
            "field": [{"x_px": x, "y_px": y, "dx_px": dx, "dy_px": dy, "arcsec": angle} for (x, y), (dx, dy), angle in field]}


def _parameters(a: Intrinsics, b: Intrinsics) -> dict:
    """Parameters that both models have, with the 1 sigma of their difference if the two were measured independently."""
    one, other = (dict(zip(lens.parameter_names, zip(lens.parameters.tolist(), np.diag(lens.covariance).tolist(), strict=True),
                           strict=True)) for lens in (a, b))
    return {name: {"a": one[name][0], "b": other[name][0], "difference": other[name][0] - one[name][0],
                   "uncertainty": _finite(math.sqrt(one[name][1] + other[name][1]))} for name in one if name in other}


def _without_name(change: object) -> dict:
    values = dataclasses.asdict(change)
    del values["name"]
    return values


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _paragraphs(values: dict) -> Iterator[str]:
    if lens := values["intrinsics"]:
        expected = "unknown" if lens["expected_rms_px"] is None else f"{lens['expected_rms_px']:.3g} px"
        turn = ", ".join(f"{angle:.4g}" for angle in lens["rotation_removed_arcsec"])
        yield (f"lens: {lens['rms_px']:.3g} px rms (sqrt(mean(dx^2 + dy^2))), at most {lens['largest_px']:.3g} px; "
               f"{lens['rms_arcsec']:.3g} arcsec rms, at most {lens['largest_arcsec']:.3g} arcsec\n"
               f"their uncertainties let expect {expected} rms; rotation removed about x, y, z: {turn} arcsec")
        yield table(("parameter", "A", "B", "B - A", "1 sigma"),
                    [(name, number(p["a"], 8), number(p["b"], 8), number(p["difference"], 3), number(p["uncertainty"], 2))
                     for name, p in lens["parameters"].items()])
    if values["layers"]:
        yield table(("layer (B - A)", "median", "scatter", "largest"),
                    [(name, *change.values()) for name, change in values["layers"].items()])
    if values["defects"]:
        yield table(("defect", "in A", "in B", "in both", "new", "gone", "surely new", "surely gone", "growth (sigma)"),
                    [(name, *("-" if v is None else v for v in list(change.values())[:-1]), number(change["growth_sigma"], 2))
                     for name, change in values["defects"].items()])
    for which in ("a", "b"):
        if values[f"only_in_{which}"]:
            yield f"measured in {which.upper()} alone: {', '.join(values[f'only_in_{which}'])}"
