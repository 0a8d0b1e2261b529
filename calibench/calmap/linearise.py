"""The map's linearity curve applied: signals as a linear camera would have given them."""

from __future__ import annotations

import numpy as np

from ..records import CalibrationMap


def linearise(charge_dn: np.ndarray, calmap: CalibrationMap) -> tuple[np.ndarray, np.ndarray | np.float32]:
    """Signal above the offset (H, W) DN, made linear, and the slope by which its noise grows.

    Straight lines between the curve's points; beyond its ends the first and the last line go on. Where the map has no curve the
    signal is given back and the slope is 1.
    """
    if "linearity_dn" not in calmap.measured:
        return charge_dn, np.float32(1)
    measured, linear = calmap.linearity_dn.T
    slopes = (np.diff(linear) / np.diff(measured)).astype(np.float32)
    part = np.searchsorted(measured[1:-1], charge_dn)
    slope = slopes[part]
    return linear[:-1].astype(np.float32)[part] + slope * (charge_dn - measured[:-1].astype(np.float32)[part]), slope
