"""find_stars: from a raw frame and a map to spots, fast: only what is needed is corrected.

1. Detection on raw DN against a threshold for each pixel, made once for a series: the raw value that the corrected frame's
   local background stands for, plus noise; never, where the map says that a pixel is not to be used.
2. The windows around the candidates are corrected, equal to the corrected full frame.
3. Poisson-weighted centroids with covariance; flags.

The threshold map is carried from frame to frame. It holds while map, exposure, temperature, gain setting, white level, size and
type are the same and the sky is: each frame is sampled (every DRIFT_ROWS-th row) and compared with it, in cells. While no cell
has moved by more than MOST_DRIFT_SIGMA and the noise by no more than MOST_NOISE_CHANGE, the drift is taken into account; beyond
that the map is made anew from the frame at hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..calmap.correct import correct
from ..calmap.windows import WindowLayers, Windows
from ..records import DEFECT_FLAGS, UNUSABLE, CalibrationMap, Frame, Spots
from ..spots.background import background_and_noise
from ..spots.candidates import Candidates
from ..spots.detect.kernels import CELL_PX
from ..spots.detect.scan import candidates_on
from ..spots.false_alarms import NoiseLaw, k_for_false_alarms, step_from_skewness
from ..spots.find import FALSE_ALARMS, MOST_SPOTS, ROUGH_SD_PX
from ..spots.fit.known_shape import LOST_CORE_ERROR, fit_windows, window_radius
from ..spots.flags import flag
from ..spots.frame_shape import GUESSED_SHAPE_ERROR, shape_from_frame
from ..spots.kernels import drift, lose_others
from ..spots.psf import moments_at
from ..spots.room import Room
from ..spots.scene import Centroids, Scene
from ..spots.threshold_map import ThresholdMap, threshold_map

DRIFT_ROWS = 16
MOST_DRIFT_SIGMA, MOST_NOISE_CHANGE = 0.25, 0.05
ROUGH_COVARIANCE_PX2 = np.eye(2) * ROUGH_SD_PX**2
LEAST_NOISE = 0.05  # of the noise that the map predicts: what the frame itself may show it to be


@dataclass
class FindState:
    """What is computed once for a series of frames of one camera. false_alarms: spots a frame that noise may give.

    made: how often the threshold map was made. `sky` is None before the first frame."""

    false_alarms: float = FALSE_ALARMS
    made: int = 0
    sky: _Sky | None = None
    room: Room | None = None


@dataclass(frozen=True, kw_only=True)
class _Sky:
    """A threshold map and what it was made for (`key`). radius: of the windows. moments_px2 (3,): the
    frame's own PSF, None where the map has one."""

    key: tuple
    calmap: CalibrationMap
    layers: WindowLayers
    thresholds: ThresholdMap
    k_sigma: float
    radius: int
    moments_px2: np.ndarray | None


def find_stars(frame: Frame, calmap: CalibrationMap, state: FindState) -> Spots:
    """Spots of a raw frame, brightest first; `state` carries what frames of a series share.

    Raises:
        BadInput: the frame has another size than the map.
    """
    data = frame.data if frame.data.dtype in (np.uint16, np.float32) else frame.data.astype(
        np.uint16 if frame.data.dtype.kind == "u" and frame.data.dtype.itemsize < 2 else np.float32)
    sky, moved, louder = _still_valid(frame, data, calmap, state.sky)
    if sky is None:
        sky = state.sky = _look(frame, data, calmap, state.false_alarms)
        state.made += 1
        moved, louder = sky.thresholds.no_drift, 1.0
    gain = calmap.gain_dn_per_e
    if state.room is None or state.room.shape != data.shape:
        state.room = Room(data.shape)
    candidates = candidates_on(data, sky.thresholds, sky.k_sigma * louder, drift=moved, room=state.room,
                               gain_dn_per_e=float(gain) if np.isfinite(gain) else 0.0)
    if len(candidates) == 0:
        return Spots.none()
    if len(candidates) > MOST_SPOTS:
        candidates = candidates.take(np.argsort(-candidates.flux_dn)[:MOST_SPOTS])

    known = sky.moments_px2 is None
    moments = moments_at(calmap.psf, candidates.xy_px) if known else np.tile(sky.moments_px2, (len(candidates), 1))
    centre, radius = np.rint(candidates.xy_px).astype(np.int64), sky.radius
    windows = sky.layers.windows(data, centre, radius)
    signal, lost = windows.signal_dn, (windows.defects & UNUSABLE) != 0
    core_lost = lost[:, radius - 1:radius + 2, radius - 1:radius + 2].any((1, 2))
    error = np.maximum(core_lost * LOST_CORE_ERROR, 0.0 if known else GUESSED_SHAPE_ERROR)
    lose_others(candidates.xy_px, windows.corner_xy, lost)
    signal[lost] = np.nan
    noise = sky.thresholds.noise_dn[candidates.peak_xy[:, 1], candidates.peak_xy[:, 0]] * np.float32(louder)
    floor = np.empty_like(signal)
    floor[:] = (noise**2)[:, None, None]
    found = fit_windows(signal, floor, windows.corner_xy, candidates.xy_px, moments, gain_dn_per_e=gain, model_error=error)
    flags = _flags(candidates, found, sky.layers.windows(data, candidates.peak_xy, 1), noise, frame, gain,
                   moments if known else None)
    return _spots(candidates, found, flags, frame, gain)


def _flags(candidates: Candidates, found: Centroids, near: Windows, noise: np.ndarray, frame: Frame, gain: float,
           moments: np.ndarray | None) -> np.ndarray:
    """Flags (N,). near: the corrected 3x3 pixels about each peak."""
    saturated = (near.defects & DEFECT_FLAGS["saturated"]) != 0
    broken = (near.defects & (UNUSABLE & ~DEFECT_FLAGS["saturated"])) != 0
    light = near.signal_dn - np.where(found.ok, found.background_dn, 0.0)[:, None, None]
    light[broken | ~np.isfinite(light)] = 0.0
    return flag(candidates, found, signal=light, noise_dn=noise, saturated=saturated, broken=broken,
                image_size_px=frame.image_size_px, moments_px2=moments, gain_dn_per_e=gain)


def _spots(candidates: Candidates, found: Centroids, flags: np.ndarray, frame: Frame, gain_dn_per_e: float) -> Spots:
    """Spots brightest first, those inside the frame; a spot whose fit failed keeps its rough place."""
    xy = np.where(found.ok[:, None], found.xy_px, candidates.xy_px)
    flux = np.where(found.ok, found.flux_dn, candidates.flux_dn)
    covariance = np.where(found.ok[:, None, None], found.covariance_px2, ROUGH_COVARIANCE_PX2)
    order = np.argsort(-flux)
    w, h = frame.image_size_px
    inside = (xy > -0.5).all(1) & (xy < (w - 0.5, h - 0.5)).all(1) & (flux > 0)
    order = order[inside[order]]
    gain = gain_dn_per_e if np.isfinite(gain_dn_per_e) else 1.0
    return Spots(xy_px=xy[order], covariance_px2=covariance[order], flux_e=flux[order] / gain,
                 background_dn=np.where(found.ok, found.background_dn, 0.0)[order],
                 peak_dn=candidates.peak_dn[order], pixels=candidates.pixels[order], flags=flags[order])


def _key(frame: Frame, data: np.ndarray) -> tuple:
    return data.shape, data.dtype, frame.exposure_s, frame.temperature_c, frame.gain_setting, frame.white_level_dn


def _sampled(data: np.ndarray, thresholds: ThresholdMap) -> tuple[np.ndarray, float]:
    """How the frame lies about the threshold map: (its level above it in each cell, sigma; its noise over the map's)."""
    level, count, smooth = np.zeros((3, *thresholds.coarse_dn.shape))
    square = drift(data, thresholds.expected_dn, thresholds.noise_dn, CELL_PX, DRIFT_ROWS,
                   np.empty((3, data.shape[1]), np.float32), level, count, smooth)
    return smooth, float(np.sqrt(square))


def _still_valid(frame: Frame, data: np.ndarray, calmap: CalibrationMap,
                 sky: _Sky | None) -> tuple[_Sky | None, np.ndarray | None, float]:
    """The carried threshold map with drift and change of noise, or None where the frame asks for a new one."""
    if sky is None or sky.calmap is not calmap or sky.key != _key(frame, data):
        return None, None, 1.0
    moved, louder = _sampled(data, sky.thresholds)
    if np.abs(moved).max() > MOST_DRIFT_SIGMA or abs(louder - 1) > MOST_NOISE_CHANGE:
        return None, None, 1.0
    return sky, moved, louder


def _look(frame: Frame, data: np.ndarray, calmap: CalibrationMap, false_alarms: float) -> _Sky:
    """The threshold map of a frame, its background and noise taken from the corrected full frame."""
    layers = WindowLayers.of(frame, calmap)
    corrected = correct(frame, calmap)
    blind = (corrected.defects & UNUSABLE) != 0
    blind |= ~np.isfinite(corrected.signal_dn)
    broken = ((layers.defects & UNUSABLE) != 0) | ~np.isfinite(corrected.signal_dn)
    sky, noise = background_and_noise(corrected.signal_dn, blind)
    signal = corrected.signal_dn - sky
    response = layers.response
    # Raw value at which the corrected frame would show its background; the frame's own noise falls out of the difference.
    expected = np.where(broken, np.float32(np.nan), data - signal * response)
    whole = data.dtype.kind == "u"
    if {"gain_dn_per_e", "read_noise_dn"} <= calmap.measured:
        # The map's variance with the sky in place of the pixel's own light, scaled to what the frame shows.
        variance = np.maximum(corrected.variance_dn2 * response**2 - np.float32(calmap.gain_dn_per_e) * signal * response,
                              layers.read_variance_dn2)
        _, scale = background_and_noise(signal * response / np.sqrt(variance), blind, floor=LEAST_NOISE)
        noise_raw = np.sqrt(variance) * scale
        typical = float(np.sqrt(np.median(layers.read_variance_dn2[::4, ::4])))
        law = NoiseLaw(step_dn=calmap.gain_dn_per_e, normal_dn=typical, whole_dn=whole)
    else:
        noise_raw = noise * response
        law = NoiseLaw(step_dn=step_from_skewness(signal, noise, blind), whole_dn=whole)
    thresholds = threshold_map(expected, noise_raw, data.dtype)
    k_sigma = k_for_false_alarms(thresholds, false_alarms, law)
    if "psf" in calmap.measured:
        w, h = frame.image_size_px
        places = np.array([[x, y] for x in (0, w / 2, w - 1) for y in (0, h / 2, h - 1)])
        shape, radius = None, window_radius(moments_at(calmap.psf, places))
    else:
        candidates = candidates_on(data, thresholds, k_sigma)
        scene = Scene(signal_dn=np.where(blind, np.float32(0), signal), floor_variance_dn2=noise**2, unusable=blind,
                      gain_dn_per_e=calmap.gain_dn_per_e, psf=calmap.psf, psf_known=False)
        shape = shape_from_frame(scene, candidates)
        radius = window_radius(shape[None])
    return _Sky(key=_key(frame, data), calmap=calmap, layers=layers, thresholds=thresholds, k_sigma=k_sigma,
                radius=radius, moments_px2=shape)
