"""What has changed between two calibration maps of one camera: the lens, the layers, the defective pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..records import DEFECT_FLAGS, IMAGE_LAYERS, LAYERS, SCALAR_LAYERS, CalibrationMap
from .compare_lens import LensDifference, lens_difference

# Of a normal distribution, the median absolute deviation times this is the standard deviation.
SD_PER_MAD = 1.4826


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
    """Pixels with one flag: how many in A, in B, new in B, and gone from A."""

    name: str
    in_a: int
    in_b: int
    new: int
    gone: int


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
        defects=_defects(a.defects, b.defects) if "defects" in both else (),
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


def _defects(a: np.ndarray, b: np.ndarray) -> tuple[DefectChange, ...]:
    """One entry for each flag that either map carries."""
    changes = (DefectChange(name=name, **{key: int(np.count_nonzero(pixels & bit)) for key, pixels in (
        ("in_a", a), ("in_b", b), ("new", b & ~a), ("gone", a & ~b))}) for name, bit in DEFECT_FLAGS.items())
    return tuple(change for change in changes if change.in_a or change.in_b)
