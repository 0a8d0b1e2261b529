"""What has changed between two calibration maps of one camera: the lens, the layers, the defective pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..records import DEFECT_FLAGS, IMAGE_LAYERS, LAYERS, SCALAR_LAYERS, CalibrationMap
from .compare_lens import LensDifference, lens_difference

# Of a normal distribution, the median absolute deviation times this is the standard deviation.
SD_PER_MAD = 1.4826
CERTAIN_SIGMA = 5.0
# Which layer shows that a defect of the class came or went, and in which direction a coming one moves it.
LAYER_OF_CLASS = {"hot": ("dark_rate_dn_per_s", 1), "warm": ("dark_rate_dn_per_s", 1), "stuck": ("dark_rate_dn_per_s", 1),
                  "dead": ("response", -1), "cold": ("response", -1)}
ERROR_OF_LAYER = {"dark_rate_dn_per_s": "dark_rate_uncertainty_dn_per_s", "response": "response_uncertainty"}


@dataclass(frozen=True, kw_only=True)
class LayerChange:
    """One layer, B minus A. Images: median, robust scatter (1.4826 MAD) and largest change over the pixels that neither map
    calls defective; a scalar has its difference as median and largest, and no scatter."""

    name: str
    median: float
    scatter: float
    largest: float


@dataclass(frozen=True, kw_only=True)
class DefectChange:
    """Pixels with one flag: how many in A, in B, new in B, and gone from A.

    new_certain, gone_certain: of these, the pixels whose layer (dark rate for hot, warm and stuck, response for dead and cold)
    has changed in that direction by CERTAIN_SIGMA of both maps' errors; the others stand near the threshold, which chance
    crosses both ways. None where the class has no layer with errors. growth_sigma: (new - gone) / sqrt(new + gone), McNemar's
    test of whether the class has grown; 0 where nothing changed.
    """

    name: str
    in_a: int
    in_b: int
    new: int
    gone: int
    new_certain: int | None
    gone_certain: int | None
    growth_sigma: float


@dataclass(frozen=True, kw_only=True)
class MapDifference:
    """B against A. lens and defects are None and empty where one of the maps has not measured them."""

    lens: LensDifference | None
    layers: tuple[LayerChange, ...]
    defects: tuple[DefectChange, ...]
    only_in_a: tuple[str, ...]
    only_in_b: tuple[str, ...]


def compare(a: CalibrationMap, b: CalibrationMap, fit_radius_px: float | None = None) -> MapDifference:
    """The change of every layer that both maps have measured; the lenses as `lens_difference` compares them.

    Raises:
        BadInput: the image sizes differ, or the lenses cannot be compared.
    """
    if a.image_size_px != b.image_size_px:
        sizes = " and ".join(f"{w} x {h}" for w, h in (a.image_size_px, b.image_size_px))
        raise BadInput(f"maps of {sizes} px cannot be compared",
                       mend="compare maps of the same camera at the same readout")
    both = a.measured & b.measured
    sound = (a.defects | b.defects) == 0
    return MapDifference(
        lens=lens_difference(a.intrinsics, b.intrinsics, fit_radius_px) if "intrinsics" in both else None,
        layers=tuple(_layer(name, a, b, sound) for name in (*IMAGE_LAYERS, *SCALAR_LAYERS) if name in both),
        defects=_defects(a, b) if "defects" in both else (),
        only_in_a=tuple(name for name in LAYERS if name in a.measured - b.measured),
        only_in_b=tuple(name for name in LAYERS if name in b.measured - a.measured))


def _layer(name: str, a: CalibrationMap, b: CalibrationMap, sound: np.ndarray) -> LayerChange:
    before, after = getattr(a, name), getattr(b, name)
    if name in SCALAR_LAYERS:
        return LayerChange(name=name, median=after - before, scatter=0.0, largest=after - before)
    # Where every pixel is defective, all of them still say more than none.
    pixels = sound if sound.any() else np.ones_like(sound)
    change = after[pixels].astype(float) - before[pixels]
    median = np.median(change)
    return LayerChange(name=name, median=float(median), scatter=float(SD_PER_MAD * np.median(np.abs(change - median))),
                       largest=float(change[np.argmax(np.abs(change))]))


def _defects(a: CalibrationMap, b: CalibrationMap) -> tuple[DefectChange, ...]:
    """One entry for each flag that either map carries."""
    changes = []
    for name, bit in DEFECT_FLAGS.items():
        before, after = ((calmap.defects & bit) != 0 for calmap in (a, b))
        if not (before.any() or after.any()):
            continue
        new, gone = after & ~before, before & ~after
        in_a, in_b, count_new, count_gone = (int(np.count_nonzero(pixels)) for pixels in (before, after, new, gone))
        changes.append(DefectChange(
            name=name, in_a=in_a, in_b=in_b, new=count_new, gone=count_gone,
            new_certain=_moved(name, a, b, new, 1), gone_certain=_moved(name, a, b, gone, -1),
            growth_sigma=float((count_new - count_gone) / np.sqrt(max(count_new + count_gone, 1)))))
    return tuple(changes)


def _moved(name: str, a: CalibrationMap, b: CalibrationMap, pixels: np.ndarray, sign: int) -> int | None:
    """How many of the pixels (H, W) bool have a layer that moved as the coming (1) or going (-1) of the class says; None where
    no layer with errors shows it."""
    layer, direction = LAYER_OF_CLASS.get(name, ("", 0))
    if not {layer, ERROR_OF_LAYER.get(layer)} <= a.measured & b.measured:
        return None
    change = getattr(b, layer)[pixels].astype(float) - getattr(a, layer)[pixels]
    error = np.hypot(*(getattr(calmap, ERROR_OF_LAYER[layer])[pixels].astype(float) for calmap in (a, b)))
    return int(np.count_nonzero(sign * direction * change > CERTAIN_SIGMA * error))
