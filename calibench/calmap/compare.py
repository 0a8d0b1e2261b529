"""What has changed between two calibration maps of one camera: the lens, the layers, the defective pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..records import DEFECT_FLAGS, IMAGE_LAYERS, LAYERS, SCALAR_LAYERS, CalibrationMap
from .compare_lens import LensDifference, lens_difference
from .dark_signal import SAME_TEMPERATURE_C
from .thermal import BOLTZMANN_EV_PER_K, ZERO_C_K, warming

# Of a normal distribution, the median absolute deviation times this is the standard deviation.
SD_PER_MAD = 1.4826
CERTAIN_SIGMA = 5.0
# Which layer shows that a defect of the class came or went, and in which direction a coming one moves it.
LAYER_OF_CLASS = {"hot": ("dark_rate_dn_per_s", 1), "warm": ("dark_rate_dn_per_s", 1), "stuck": ("dark_rate_dn_per_s", 1),
                  "dead": ("response", -1), "cold": ("response", -1)}
ERROR_OF_LAYER = {"dark_rate_dn_per_s": "dark_rate_uncertainty_dn_per_s", "response": "response_uncertainty"}
ENERGY_SPREAD_EV = 0.05  # by which pixels' activation energies differ from that of the mean dark current


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
    """Pixels with one flag: how many in A, in B, in both (confirmed), new in B, and gone from A.

    new_certain, gone_certain: of these, the pixels whose layer (dark rate for hot, warm and stuck, response for dead and cold)
    has changed in that direction by CERTAIN_SIGMA of both maps' errors, A's dark rate brought to B's gain and temperature; the
    others stand near the threshold, which chance and other conditions cross. None where the class has no layer with errors, or
    the rates cannot be brought to one temperature. growth_sigma: (new - gone) / sqrt(new + gone), McNemar's test of whether the
    class has grown, of the certain ones where they are known; 0 where nothing changed.
    """

    name: str
    in_a: int
    in_b: int
    confirmed: int
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
        defects=defect_changes(a, b) if "defects" in both else (),
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


def defect_changes(a: CalibrationMap, b: CalibrationMap) -> tuple[DefectChange, ...]:
    """One entry for each flag that either map carries."""
    changes = []
    for name, bit in DEFECT_FLAGS.items():
        before, after = ((calmap.defects & bit) != 0 for calmap in (a, b))
        if not (before.any() or after.any()):
            continue
        new, gone = after & ~before, before & ~after
        in_a, in_b, both, came, went = (int(np.count_nonzero(pixels)) for pixels in (before, after, before & after, new, gone))
        surely = (_moved(name, a, b, new, 1), _moved(name, a, b, gone, -1))
        grown, shrunk = (came, went) if None in surely else surely
        changes.append(DefectChange(
            name=name, in_a=in_a, in_b=in_b, confirmed=both, new=came, gone=went, new_certain=surely[0], gone_certain=surely[1],
            growth_sigma=float((grown - shrunk) / np.sqrt(max(grown + shrunk, 1)))))
    return tuple(changes)


def _moved(name: str, a: CalibrationMap, b: CalibrationMap, pixels: np.ndarray, sign: int) -> int | None:
    """How many of the pixels (H, W) bool have a layer that moved as the coming (1) or going (-1) of the class says; None where
    no layer with errors shows it."""
    layer, direction = LAYER_OF_CLASS.get(name, ("", 0))
    if not {layer, ERROR_OF_LAYER.get(layer)} <= a.measured & b.measured:
        return None
    factor, spread = _conditions(a, b) if layer == "dark_rate_dn_per_s" else (1.0, 0.0)
    if not np.isfinite(factor):
        return None
    before, after = (getattr(calmap, layer)[pixels].astype(float) for calmap in (a, b))
    errors = [getattr(calmap, ERROR_OF_LAYER[layer])[pixels].astype(float) for calmap in (a, b)]
    error = np.sqrt((factor * errors[0]) ** 2 + errors[1] ** 2 + (spread * factor * before) ** 2)
    return int(np.count_nonzero(sign * direction * (after - factor * before) > CERTAIN_SIGMA * error))


def _conditions(a: CalibrationMap, b: CalibrationMap) -> tuple[float, float]:
    """What a dark rate of A in DN/s would be in B, at another gain setting and temperature, as a factor; and the relative
    1-sigma by which single pixels differ from it. NaN where the temperatures differ and neither map knows their law."""
    settings = {a.conditions.gain_setting, b.conditions.gain_setting}
    known = len(settings - {None}) == 2 and "gain_dn_per_e" in a.measured & b.measured
    gain = b.gain_dn_per_e / a.gain_dn_per_e if known else 1.0
    if "dark_reference_c" not in a.measured & b.measured:
        return gain, 0.0
    cold, warm = a.dark_reference_c, b.dark_reference_c
    law = next((c.dark_activation_ev for c in (b, a) if "dark_activation_ev" in c.measured), None)
    if law is None:
        return (gain, 0.0) if abs(warm - cold) <= SAME_TEMPERATURE_C else (np.nan, np.nan)
    inverse_k = abs(1 / (cold + ZERO_C_K) - 1 / (warm + ZERO_C_K))
    return gain * float(warming(warm, cold, law)), ENERGY_SPREAD_EV / BOLTZMANN_EV_PER_K * inverse_k
