"""The map applied to a frame: offset and dark removed, response divided out, variance and defects beside it.

    charge   = linearised (data - offset)                                                               [DN]
    signal   = (charge - dark rate * exposure * warming) / response                                     [DN]
    variance = (slope^2 max(read noise^2, 1/12) + gain * max(charge, 0)) / response^2                   [DN^2]

This is the linear camera model of EMVA 1288 (release 4.0 Linear, section 2): shot noise of `gain` DN/e- on all charge
collected, light and dark alike; slope: of the linearity curve (1 without one); warming: Arrhenius law from the temperature of
the darks to the frame's (1 without one). The illumination layer is not divided out: it belongs to lens and lamp, not to a star.
"""

from __future__ import annotations

import numpy as np

from ..errors import BadInput
from ..records import DEFECT_FLAGS, UNUSABLE, CalibrationMap, CorrectedFrame, Frame
from .conditions import outside_conditions, unchecked_conditions
from .dark_signal import dark_seconds, without_harmless
from .linearise import linearise

__all__ = ["correct", "correction_warnings", "interpolate_defects", "outside_conditions", "read_variance_dn2", "require_size",
           "saturation_of", "unchecked_conditions"]

# Variance of rounding to whole DN (EMVA 1288, sigma_q^2).
QUANTISATION_DN2 = 1 / 12


def require_size(frame: Frame, calmap: CalibrationMap) -> None:
    """Refuse a frame of another size than the map's.

    Raises:
        BadInput: with both sizes.
    """
    if frame.image_size_px != calmap.image_size_px:
        (w, h), (map_w, map_h) = frame.image_size_px, calmap.image_size_px
        raise BadInput(f"the frame is {w} x {h} pixels, the map {map_w} x {map_h}", file=frame.file or None,
                       mend="use the map of this camera at this binning and window")


def saturation_of(frame: Frame, calmap: CalibrationMap) -> float:
    """Level (DN) from which a pixel of this frame is saturated: the white level or the measured saturation, the lower one.

    Where no source states the converter's bits, those of the map's own frames count.
    """
    white_dn = frame.white_level_dn
    if frame.range_assumed and calmap.conditions.bit_depth is not None:
        white_dn = min(white_dn, 2.0**calmap.conditions.bit_depth - 1)
    return float(min(white_dn, calmap.saturation_dn))


def read_variance_dn2(calmap: CalibrationMap) -> np.ndarray:
    """(H, W) variance of the read noise layer, at least that of rounding."""
    return np.maximum(calmap.read_noise_dn**2, np.float32(QUANTISATION_DN2))


def correction_warnings(frame: Frame, calmap: CalibrationMap) -> tuple[str, ...]:
    """What has to be said of this frame's correction: conditions that could not be checked, dark charge that is not scaled."""
    said = dark_seconds(frame, calmap)[1] if "dark_rate_dn_per_s" in calmap.measured else []
    return (*unchecked_conditions(frame, calmap), *said)


def correct(frame: Frame, calmap: CalibrationMap) -> CorrectedFrame:
    """The frame after the map. Layers that were not measured are identities and change nothing.

    variance_dn2 is the random part only; the map's own uncertainty is common to all frames and stays in the map.
    It is NaN everywhere where the map has no read noise: nothing in a single frame tells it, and the consumer has to
    estimate it from the sky. The read noise layer is the temporal scatter of raw frames, so quantisation is in it and
    1/12 DN^2 is only its floor. Where the gain is unknown, shot noise is missing: the variance holds for a dark sky.

    defects: the map's flags, hot pixels that do no harm in this frame being warm (`without_harmless`), `saturated` at and
    above min(white level, measured saturation), `dead` where the response is not positive; there the response is taken as 1, so
    that the signal stays finite.
    A frame without an exposure keeps its dark charge (only the offset is removed) and the warnings say so.

    Raises:
        BadInput: the frame has another size than the map.
    """
    require_size(frame, calmap)
    charge_dn, slope = linearise(frame.data.astype(np.float32) - calmap.offset_dn, calmap)
    signal_dn = charge_dn
    defects = calmap.defects
    if "dark_rate_dn_per_s" in calmap.measured:
        seconds, _ = dark_seconds(frame, calmap)
        if seconds is not None:
            signal_dn = charge_dn - calmap.dark_rate_dn_per_s * np.float32(seconds)
            defects = without_harmless(calmap, seconds)

    responds = calmap.response > 0
    response = np.where(responds, calmap.response, np.float32(1))
    saturated = frame.data >= saturation_of(frame, calmap)
    defects = defects | saturated * np.uint16(DEFECT_FLAGS["saturated"])
    defects |= ~responds * np.uint16(DEFECT_FLAGS["dead"])

    if "read_noise_dn" in calmap.measured:
        variance_dn2 = slope**2 * read_variance_dn2(calmap)
        if "gain_dn_per_e" in calmap.measured:
            variance_dn2 = variance_dn2 + np.float32(calmap.gain_dn_per_e) * np.maximum(charge_dn, 0)
        variance_dn2 = variance_dn2 / response**2
    else:
        variance_dn2 = np.full(signal_dn.shape, np.nan, np.float32)
    return CorrectedFrame(signal_dn=signal_dn / response, variance_dn2=variance_dn2, defects=defects,
                          gain_dn_per_e=calmap.gain_dn_per_e, file=frame.file, warnings=correction_warnings(frame, calmap))


def interpolate_defects(signal: np.ndarray, defects: np.ndarray) -> np.ndarray:
    """A copy of the (H, W) signal in which each UNUSABLE pixel is the mean of the good ones among its 8 neighbours.

    Inside a cluster, where no neighbour is good, the pixels filled from its rim are used in turn.

    Raises:
        BadInput: no pixel is good.
    """
    bad = (defects & UNUSABLE) != 0
    if bad.all():
        raise BadInput("every pixel is a defect: there is nothing to interpolate from")
    filled = np.pad(np.where(bad, 0, signal), 1)
    good = np.pad(~bad, 1)
    rows, columns = np.nonzero(np.pad(bad, 1))
    around = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]
    while len(rows):
        count = sum(good[rows + dy, columns + dx].astype(int) for dy, dx in around)
        total = sum(np.where(good[rows + dy, columns + dx], filled[rows + dy, columns + dx], 0) for dy, dx in around)
        ready = count > 0
        filled[rows[ready], columns[ready]] = total[ready] / count[ready]
        good[rows[ready], columns[ready]] = True
        rows, columns = rows[~ready], columns[~ready]
    return filled[1:-1, 1:-1]
