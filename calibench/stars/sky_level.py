"""SkyLevel: what a frame shows where there is no star, made once for a series; RawScene: a frame seen against it.

Detection compares raw values with a threshold for each pixel: the raw value that the corrected frame's local background
stands for, plus noise; never, where the map says that a pixel is not to be used. Centroids are taken in windows that the map
has corrected, with this background taken off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..calmap.correct import correct
from ..calmap.dark_signal import SAME_TEMPERATURE_C
from ..calmap.linearise import linearise
from ..calmap.windows import WindowLayers, like
from ..records import UNUSABLE, CalibrationMap, Frame, PsfMap
from ..spots.background import background_and_noise, busy_area
from ..spots.candidates import Candidates
from ..spots.detect.kernels import CELL_PX
from ..spots.detect.scan import candidates_on
from ..spots.false_alarms import NoiseLaw, Sensitivity, step_from_skewness
from ..spots.flags import Near
from ..spots.frame_shape import shape_from_frame
from ..spots.kernels import above_sky, drift
from ..spots.room import Room
from ..spots.scene import Patches
from ..spots.threshold_map import ThresholdMap, threshold_map

DRIFT_ROWS = 16
LEAST_NOISE = 0.05  # of the noise that the map predicts: what the frame itself may show it to be


@dataclass(frozen=True, kw_only=True)
class SkyLevel:
    """For frames like the one it was made from. thresholds: in raw DN; k_sigma: of detection on them. background_dn, noise_dn
    (H, W) float32: of the corrected frame, noise of one pixel. busy: (H, W) bool, restless areas, None where there are
    none. shape_px2 (3,): moments that the frame's own stars show, None where the map has a PSF. kind, temperature_c: of
    the frame (calmap/windows.like)."""

    calmap: CalibrationMap
    kind: tuple
    temperature_c: float | None
    thresholds: ThresholdMap
    k_sigma: float
    background_dn: np.ndarray
    noise_dn: np.ndarray
    busy: np.ndarray | None
    room: Room
    shape_px2: np.ndarray | None = None

    @classmethod
    def of(cls, frame: Frame, data: np.ndarray, layers: WindowLayers, calmap: CalibrationMap, k_sigma: float | None,
           false_alarms: float) -> SkyLevel:
        """From a frame corrected as a whole. data: the frame's, of a type that is scanned; layers: the map's for it."""
        corrected = correct(frame, calmap)
        blind = ((corrected.defects & UNUSABLE) != 0) | ~np.isfinite(corrected.signal_dn)
        broken = ((layers.defects & UNUSABLE) != 0) | ~np.isfinite(corrected.signal_dn)
        background, noise = background_and_noise(corrected.signal_dn, blind)
        restless = busy_area(noise)
        signal, response, slope = corrected.signal_dn - background, layers.response, _slope(data, layers, calmap)
        whole = data.dtype.kind == "u"
        if {"gain_dn_per_e", "read_noise_dn"} <= calmap.measured:
            # The map's variance of the sky alone, scaled to what the frame shows.
            charge = np.maximum(background * response + layers.dark_dn, 0)
            predicted = np.sqrt(slope**2 * layers.read_variance_dn2 + np.float32(calmap.gain_dn_per_e) * charge) / response
            _, scale = background_and_noise(signal / predicted, blind, floor=LEAST_NOISE)
            noise = predicted * scale
            typical = float(np.sqrt(np.median(layers.read_variance_dn2[::4, ::4])))
            law = NoiseLaw(step_dn=calmap.gain_dn_per_e, normal_dn=typical, whole_dn=whole)
        else:
            law = NoiseLaw(step_dn=step_from_skewness(signal, noise, blind), whole_dn=whole)
        raw = response / slope  # raw DN that stand for one corrected DN of the sky
        # Raw value at which the corrected frame would show its background; the frame's own noise falls out of the difference.
        expected = np.where(broken, np.float32(np.nan), data - np.where(broken, np.float32(0), signal) * raw)
        thresholds = threshold_map(expected, noise * raw, data.dtype)
        k = Sensitivity(k_sigma=k_sigma, false_alarms=false_alarms, law=law).k_on(thresholds)
        level = cls(calmap=calmap, kind=like(frame), temperature_c=frame.temperature_c, thresholds=thresholds, k_sigma=k,
                    background_dn=background, noise_dn=noise, busy=restless if restless.any() else None, room=Room(data.shape))
        if "psf" in calmap.measured:
            return level
        scene = level.scene(data, layers)
        return replace(level, shape_px2=shape_from_frame(scene, scene.candidates()))

    def serves(self, frame: Frame) -> bool:
        """Whether the frame was taken like the one that this was made from."""
        same = frame.temperature_c == self.temperature_c
        if not same and None not in (frame.temperature_c, self.temperature_c):
            same = abs(frame.temperature_c - self.temperature_c) <= SAME_TEMPERATURE_C
        return same and like(frame) == self.kind

    def sampled(self, data: np.ndarray) -> tuple[np.ndarray, float]:
        """How a frame lies about this level: (cells, how far above it, in sigma; its noise over this one's)."""
        smooth = np.empty(self.thresholds.coarse_dn.shape)
        square = drift(data, self.thresholds.expected_dn, self.thresholds.noise_dn, CELL_PX, DRIFT_ROWS, smooth)
        return smooth, square**0.5

    def scene(self, data: np.ndarray, layers: WindowLayers) -> RawScene:
        """The frame that this was made from."""
        return RawScene(data=data, layers=layers, level=self, drifted=self.thresholds.no_drift, louder=1.0)


@dataclass(frozen=True, kw_only=True)
class RawScene:
    """A raw frame as the Scene of its candidates: its windows are corrected, equal to the corrected full frame.

    drifted, louder: as `SkyLevel.sampled` gives them."""

    data: np.ndarray
    layers: WindowLayers
    level: SkyLevel
    drifted: np.ndarray
    louder: float

    @property
    def psf(self) -> PsfMap:
        return self.level.calmap.psf

    @property
    def psf_known(self) -> bool:
        return self.level.shape_px2 is None and "psf" in self.level.calmap.measured

    @property
    def shape_px2(self) -> np.ndarray | None:
        return self.level.shape_px2

    @property
    def gain_dn_per_e(self) -> float:
        return self.level.calmap.gain_dn_per_e

    def candidates(self) -> Candidates:
        """What stands out of the sky, brightest first."""
        gain = self.gain_dn_per_e
        return candidates_on(self.data, self.level.thresholds, self.level.k_sigma * self.louder, drift=self.drifted,
                             room=self.level.room, gain_dn_per_e=gain if gain == gain else 0.0)

    def patches(self, centre_xy: np.ndarray, radius: int) -> Patches:
        """Windows of 2 radius + 1 pixels about integer centres (N, 2)."""
        return self._patches(centre_xy, radius)[0]

    def near(self, peak_xy: np.ndarray) -> Near:
        """What stands about each peak (N, 2)."""
        x, y = peak_xy.T
        patches, defects = self._patches(peak_xy, 1)
        return Near(signal_dn=patches.signal_dn, defects=defects, noise_dn=self.level.noise_dn[y, x] * np.float32(self.louder),
                    background_dn=self.level.background_dn[y, x])

    def _patches(self, centre_xy: np.ndarray, radius: int) -> tuple[Patches, np.ndarray]:
        cut_out, level = self.layers.windows(self.data, centre_xy, radius), self.level
        floor = np.empty_like(cut_out.signal_dn)
        above_sky(cut_out.signal_dn, cut_out.defects, cut_out.corner_xy, level.background_dn, level.noise_dn, self.drifted,
                  CELL_PX, float(self.louder), floor)
        return Patches(signal_dn=cut_out.signal_dn, floor_variance_dn2=floor, corner_xy=cut_out.corner_xy), cut_out.defects


def _slope(data: np.ndarray, layers: WindowLayers, calmap: CalibrationMap) -> np.float32:
    """Slope of the linearity curve at the sky's level: of one frame, the median."""
    part = np.s_[::8, ::8]
    offset = layers.offset_dn if layers.offset_dn.size == 1 else layers.offset_dn[part]
    return np.float32(np.median(linearise(data[part].astype(np.float32) - offset, calmap)[1]))
