"""The map's dark rate at the exposure and temperature of a frame, and which hot pixels do no harm there."""

from __future__ import annotations

import numpy as np

from ..records import DEFECT_FLAGS, CalibrationMap, Frame
from .thermal import warming

# Nearer to the reference than this the dark rate changes by less than 5 %.
SAME_TEMPERATURE_C = 0.5


def dark_seconds(frame: Frame, calmap: CalibrationMap) -> tuple[float | None, list[str]]:
    """Exposure at the map's reference temperature that collects the frame's dark charge, and what has to be said of it.

    None: the frame states no exposure. A temperature that is not stated is said by `unchecked_conditions`.
    """
    if frame.exposure_s is None:
        return None, ["the frame states no exposure: only the offset was removed, its dark charge is still there"]
    celsius, reference = frame.temperature_c, calmap.dark_reference_c
    if "dark_reference_c" not in calmap.measured or celsius is None:
        return frame.exposure_s, []
    if "dark_activation_ev" in calmap.measured:
        return frame.exposure_s * float(warming(celsius, reference, calmap.dark_activation_ev)), []
    if abs(celsius - reference) <= SAME_TEMPERATURE_C:
        return frame.exposure_s, []
    return frame.exposure_s, [f"the frame was taken at {celsius:.1f} C, the dark rate at {reference:.1f} C: without a law of "
                              "the temperature it was not scaled (measure darks at several temperatures)"]


def without_harmless(calmap: CalibrationMap, seconds: float) -> np.ndarray:
    """The map's flags (H, W) for a frame with `dark_seconds`: a hot pixel that is harmless in it is warm instead.

    Harmless: the shot noise of its dark signal is at most the read noise, and so is the map's error of that signal. After the
    correction such a pixel is at most sqrt(3) times as noisy as its neighbours and its variance says so, which costs a star
    less than a hole in its image. A pixel that is noisy or telegraph besides stays blind by those flags.
    """
    if not {"gain_dn_per_e", "read_noise_dn", "dark_rate_dn_per_s", "defects"} <= calmap.measured:
        return calmap.defects
    hot, warm = (np.uint16(DEFECT_FLAGS[name]) for name in ("hot", "warm"))
    at = np.nonzero(calmap.defects & hot)
    read_dn2 = calmap.read_noise_dn[at] ** 2
    shot_dn2 = calmap.gain_dn_per_e * seconds * calmap.dark_rate_dn_per_s[at]
    error_dn2 = (seconds * calmap.dark_rate_uncertainty_dn_per_s[at]) ** 2
    flags = calmap.defects[at]
    out = calmap.defects.copy()
    out[at] = np.where((shot_dn2 <= read_dn2) & (error_dn2 <= read_dn2), flags & ~hot | warm, flags)
    return out
