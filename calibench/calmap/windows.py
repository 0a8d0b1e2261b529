"""The map applied only where it is needed: to square windows of a raw frame, equal to the corrected full frame there.

What depends on the map, exposure and temperature alone is made once for a series (`WindowLayers`); a frame is then touched
in its windows only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..records import DEFECT_FLAGS, CalibrationMap, Frame
from .correct import QUANTISATION_DN2, require_size
from .dark_signal import dark_seconds, without_harmless
from .linearise import linearise


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Corrected windows: signal_dn, variance_dn2 (N, n, n) float32 as in CorrectedFrame, defects (N, n, n) uint16; corner_xy
    (N, 2): the frame's pixel at [0, 0]. Beyond the frame's edge signal and variance are NaN."""

    signal_dn: np.ndarray
    variance_dn2: np.ndarray
    defects: np.ndarray
    corner_xy: np.ndarray


@dataclass(frozen=True, kw_only=True)
class WindowLayers:
    """A map made ready for frames of one exposure and temperature. dark_dn: dark charge, None where the map or the frame knows
    none; response: None where it is 1 everywhere; read_variance_dn2: None where it was not measured; defects (H, W)."""

    calmap: CalibrationMap
    dark_dn: np.ndarray | None
    response: np.ndarray | None
    read_variance_dn2: np.ndarray | None
    defects: np.ndarray
    saturation_dn: float

    @classmethod
    def of(cls, frame: Frame, calmap: CalibrationMap) -> WindowLayers:
        """The layers for frames taken like this one.

        Raises:
            BadInput: the frame has another size than the map.
        """
        require_size(frame, calmap)
        dark, defects = None, calmap.defects
        if "dark_rate_dn_per_s" in calmap.measured:
            seconds, _ = dark_seconds(frame, calmap)
            if seconds is not None:
                dark, defects = calmap.dark_rate_dn_per_s * np.float32(seconds), without_harmless(calmap, seconds)
        responds = calmap.response > 0
        response = np.where(responds, calmap.response, np.float32(1)) if "response" in calmap.measured else None
        read = (np.maximum(calmap.read_noise_dn**2, np.float32(QUANTISATION_DN2)) if "read_noise_dn" in calmap.measured
                else None)
        white_dn = frame.white_level_dn
        if frame.range_assumed and calmap.conditions.bit_depth is not None:
            white_dn = min(white_dn, 2.0**calmap.conditions.bit_depth - 1)
        return cls(calmap=calmap, dark_dn=dark, response=response, read_variance_dn2=read,
                   defects=defects | ~responds * np.uint16(DEFECT_FLAGS["dead"]),
                   saturation_dn=float(min(white_dn, calmap.saturation_dn)))

    def windows(self, data: np.ndarray, centre_xy: np.ndarray, radius: int) -> Windows:
        """Windows of 2 radius + 1 pixels about integer centres (N, 2) of a frame's data (H, W), corrected as `correct` does."""
        h, w = data.shape
        reach = np.arange(-radius, radius + 1)
        x, y = centre_xy[:, 0, None, None] + reach, centre_xy[:, 1, None, None] + reach[:, None]
        place = y * w + x
        outside = None
        if len(centre_xy) and (centre_xy.min() < radius or centre_xy[:, 0].max() >= w - radius
                               or centre_xy[:, 1].max() >= h - radius):
            outside = (x < 0) | (y < 0) | (x >= w) | (y >= h)
            place = np.clip(y, 0, h - 1) * w + np.clip(x, 0, w - 1)
        raw = data.ravel()[place]
        charge, slope = linearise(raw.astype(np.float32) - self.calmap.offset_dn.ravel()[place], self.calmap)
        signal = charge if self.dark_dn is None else charge - self.dark_dn.ravel()[place]
        response = np.float32(1) if self.response is None else self.response.ravel()[place]
        if self.read_variance_dn2 is None:
            variance = np.full(signal.shape, np.nan, np.float32)
        else:
            variance = slope**2 * self.read_variance_dn2.ravel()[place]
            if "gain_dn_per_e" in self.calmap.measured:
                variance = variance + np.float32(self.calmap.gain_dn_per_e) * np.maximum(charge, 0)
            variance = variance / response**2
        defects = self.defects.ravel()[place] | (raw >= self.saturation_dn) * np.uint16(DEFECT_FLAGS["saturated"])
        signal = signal / response
        if outside is not None:
            signal, variance = (np.where(outside, np.float32(np.nan), a) for a in (signal, variance))
        return Windows(signal_dn=signal, variance_dn2=variance, defects=defects, corner_xy=centre_xy - radius)
