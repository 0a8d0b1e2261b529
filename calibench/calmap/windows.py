"""The map applied only where it is needed: to square windows of a raw frame, equal to the corrected full frame there.

What depends on the map, exposure and temperature alone is made once for a series (`WindowLayers`); a frame is then touched
in its windows only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..records import DEFECT_FLAGS, CalibrationMap, Frame
from .correct import read_variance_dn2, require_size, saturation_of
from .dark_signal import dark_seconds, without_harmless
from .kernels import correct_windows, sky_variance

NOTHING = np.zeros(0, np.float32)


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Corrected windows: signal_dn (N, n, n) float32 and defects (N, n, n) uint16 as in CorrectedFrame; corner_xy
    (N, 2): the frame's pixel at [0, 0]. Beyond the frame's edge the signal is NaN and defects are 0."""

    signal_dn: np.ndarray
    defects: np.ndarray
    corner_xy: np.ndarray


@dataclass(frozen=True, kw_only=True)
class WindowLayers:
    """A map made ready for frames of one exposure and temperature.

    offset_dn, dark_dn (dark charge), response: (H, W), or (1, 1) where the map or the frame knows none. read_variance_dn2:
    (H, W), None where it was not measured. curve_dn: points of the linearity curve, measured (P,) and linear (P,), none
    without one. gain_dn_per_e: NaN where it was not measured.
    """

    offset_dn: np.ndarray
    dark_dn: np.ndarray
    response: np.ndarray
    read_variance_dn2: np.ndarray | None
    curve_dn: tuple[np.ndarray, np.ndarray]
    defects: np.ndarray
    saturation_dn: float
    gain_dn_per_e: float

    @classmethod
    def of(cls, frame: Frame, calmap: CalibrationMap) -> WindowLayers:
        """The layers for frames taken like this one.

        Raises:
            BadInput: the frame has another size than the map.
        """
        require_size(frame, calmap)
        zero = np.zeros((1, 1), np.float32)
        offset = np.ascontiguousarray(calmap.offset_dn, np.float32) if "offset_dn" in calmap.measured else zero
        dark, defects = zero, calmap.defects
        if "dark_rate_dn_per_s" in calmap.measured:
            seconds, _ = dark_seconds(frame, calmap)
            if seconds is not None:
                dark, defects = calmap.dark_rate_dn_per_s * np.float32(seconds), without_harmless(calmap, seconds)
        response = zero + np.float32(1)
        if "response" in calmap.measured:
            responds = calmap.response > 0
            response = np.where(responds, calmap.response, np.float32(1))
            defects = defects | ~responds * np.uint16(DEFECT_FLAGS["dead"])
        read = None
        if "read_noise_dn" in calmap.measured:
            read = np.ascontiguousarray(read_variance_dn2(calmap), np.float32)
        curve = (tuple(np.ascontiguousarray(calmap.linearity_dn.T, np.float32)) if "linearity_dn" in calmap.measured
                 else (NOTHING, NOTHING))
        return cls(offset_dn=offset, dark_dn=dark, response=response, read_variance_dn2=read, curve_dn=curve,
                   defects=np.array(defects, np.uint16, order="C"), saturation_dn=saturation_of(frame, calmap),
                   gain_dn_per_e=calmap.gain_dn_per_e)

    def windows(self, data: np.ndarray, centre_xy: np.ndarray, radius: int) -> Windows:
        """Windows of 2 radius + 1 pixels about integer centres (N, 2) of a frame's data (H, W), corrected as `correct` does."""
        signal = np.empty((len(centre_xy), 2 * radius + 1, 2 * radius + 1), np.float32)
        defects = np.empty(signal.shape, np.uint16)
        correct_windows(data, centre_xy, radius, self.offset_dn, self.dark_dn, self.response, self.defects, *self.curve_dn,
                        self.saturation_dn, np.uint16(DEFECT_FLAGS["saturated"]), signal, defects)
        return Windows(signal_dn=signal, defects=defects, corner_xy=centre_xy - radius)

    def read_variance_at(self, xy: np.ndarray) -> np.ndarray:
        """Variance (N,) of the read noise in raw DN at integer pixels (N, 2) of the frame; 0 where the map does not know it."""
        if self.read_variance_dn2 is None:
            return np.zeros(len(xy), np.float32)
        return self.read_variance_dn2[xy[:, 1], xy[:, 0]]

    def sky_variance_dn2(self, corner_xy: np.ndarray, side: int, background_dn: np.ndarray) -> np.ndarray | None:
        """Variance (N, side, side) float32 of the corrected pixels of windows at corner_xy (N, 2) under a sky of background_dn
        (N,), as `correct` has it; None where the map does not know read noise and gain."""
        if self.read_variance_dn2 is None or not np.isfinite(self.gain_dn_per_e):
            return None
        out = np.empty((len(corner_xy), side, side), np.float32)
        sky_variance(corner_xy, np.ascontiguousarray(background_dn, float), self.read_variance_dn2, self.dark_dn, self.response,
                     *self.curve_dn, float(self.gain_dn_per_e), out)
        return out


def like(frame: Frame) -> tuple:
    """What frames must share, besides their temperature, for one map's layers to serve them all."""
    return (frame.data.shape, frame.data.dtype, frame.exposure_s, frame.gain_setting, frame.white_level_dn, frame.range_assumed)


class SeriesLayers:
    """The layers of one map for the frames of a series, made anew where a frame is not like the one before."""

    def __init__(self, calmap: CalibrationMap) -> None:
        self.calmap = calmap
        self._of: tuple = ()
        self._layers: WindowLayers | None = None

    def of(self, frame: Frame) -> WindowLayers:
        """The layers for this frame.

        Raises:
            BadInput: the frame has another size than the map.
        """
        wanted = (*like(frame), frame.temperature_c)
        if wanted != self._of:
            self._of, self._layers = wanted, WindowLayers.of(frame, self.calmap)
        return self._layers
