"""Spots at expected places: a frame is touched in the windows about them only, which the map corrects as it does for `solve`.

Points are centred by the named centroider, as those that a detector found are; light drawn along a trail by a fit of that
trail, whose middle is the star's place at mid-exposure.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ... import registry
from ...calmap.windows import WindowLayers
from ...records import SPOT_FLAGS, UNUSABLE, CalibrationMap, PsfMap, Spots
from ...spots.candidates import Candidates
from ...spots.frame_shape import moments_of, shape_from_frame
from ...spots.scene import NAN, Centroids, Patches
from .windows.kernels import fit_trails, locate

SHORT_PX = 0.5  # a trail shorter than this is a point
UNKNOWN_SIGMA_PX = 1.0
SIGMAS = 2.5  # half width of what must be free of defects
LARGEST_RADIUS_PX = 40
UNUSABLE_PIXEL = np.uint16(UNUSABLE)


@dataclass(frozen=True, kw_only=True)
class ExpectedScene:
    """A raw frame as the Scene of spots at expected places. background_dn, noise_dn2 (N,): about each spot, by its window's
    border; the noise serves where the map does not know it. shape_px2: as Scene says."""

    data: np.ndarray
    layers: WindowLayers
    psf: PsfMap
    psf_known: bool
    shape_px2: np.ndarray | None
    background_dn: np.ndarray
    noise_dn2: np.ndarray

    @property
    def gain_dn_per_e(self) -> float:
        return self.layers.gain_dn_per_e

    def patches(self, centre_xy: np.ndarray, radius: int) -> Patches:
        """Windows of 2 radius + 1 pixels about integer centres (N, 2), one for each spot."""
        cut_out = self.layers.windows(self.data, centre_xy, radius)
        signal = cut_out.signal_dn - self.background_dn[:, None, None].astype(np.float32)
        signal[(cut_out.defects & UNUSABLE_PIXEL) != 0] = NAN
        floor = self.layers.sky_variance_dn2(cut_out.corner_xy, 2 * radius + 1, self.background_dn)
        if floor is None:
            floor = np.empty_like(signal)
            floor[:] = self.noise_dn2[:, None, None]
        return Patches(signal_dn=signal, floor_variance_dn2=floor, corner_xy=cut_out.corner_xy)


@dataclass
class Expecting:
    """Measures spots at expected places with one map. shape_px2: moments that the series' first frame showed, None where the
    map has a PSF or before that frame."""

    calmap: CalibrationMap
    centroider: str = "psf_map"
    shape_px2: np.ndarray | None = None

    def measure(self, data: np.ndarray, layers: WindowLayers, xy_px: np.ndarray, trail_px: np.ndarray,
                reach_px: int) -> tuple[np.ndarray, Spots]:
        """Which of the places (N, 2) show a spot, at most reach_px off, and those spots, in their order.

        trail_px: (N, 2), how far each star's image moves during the exposure."""
        sigma, longest = self._widest_px(), float(np.abs(trail_px).max(initial=0.0))
        radius = min(max(math.ceil(SIGMAS * sigma + longest / 2), 2), LARGEST_RADIUS_PX)
        centre = np.rint(xy_px).astype(np.int64)
        cut_out = layers.windows(data, centre, reach_px + radius)
        gain = layers.gain_dn_per_e if layers.gain_dn_per_e == layers.gain_dn_per_e else 0.0
        found = locate(cut_out.signal_dn, cut_out.defects, UNUSABLE_PIXEL, layers.read_variance_at(centre), gain, reach_px,
                       radius)
        seen = np.flatnonzero(found[:, 0] == found[:, 0])
        found, trail = found[seen], trail_px[seen]
        rough = found[:, :2] + cut_out.corner_xy[seen]
        scene = self._scene(data, layers, found)
        candidates = _candidates(rough, found)
        if self.shape_px2 is None and not scene.psf_known:
            self.shape_px2 = shape_from_frame(scene, candidates)
            scene = self._scene(data, layers, found)
        drawn = np.hypot(*trail.T) > SHORT_PX
        centroids = self._points(scene, candidates)
        if drawn.any():
            scene, candidates = self._scene(data, layers, found[drawn]), candidates.take(drawn)
            centroids = centroids.with_rows(drawn, _trails(scene, candidates, trail[drawn], reach_px, radius))
        near = centroids.ok & (np.abs(centroids.xy_px - rough).max(1, initial=0) <= reach_px + radius)
        spots = Spots(xy_px=centroids.xy_px, covariance_px2=centroids.covariance_px2, flux_e=centroids.flux_dn / (gain or 1.0),
                      background_dn=found[:, 3] + centroids.background_dn, peak_dn=found[:, 5], pixels=np.zeros(len(found)),
                      flags=drawn * SPOT_FLAGS["trail"])
        return (seen, spots) if near.all() else (seen[near], spots.take(near))

    def _points(self, scene: ExpectedScene, candidates: Candidates) -> Centroids:
        return registry.load("calibench.spots.centroid", self.centroider).centroid(scene, candidates)

    def _widest_px(self) -> float:
        if self.shape_px2 is not None:
            return math.sqrt(self.shape_px2[:2].max())
        if "psf" not in self.calmap.measured:
            return UNKNOWN_SIGMA_PX
        return math.sqrt(max(self.calmap.psf.coefficients[0, 0], self.calmap.psf.coefficients[1, 0]))

    def _scene(self, data: np.ndarray, layers: WindowLayers, found: np.ndarray) -> ExpectedScene:
        return ExpectedScene(data=data, layers=layers, psf=self.calmap.psf, psf_known="psf" in self.calmap.measured,
                             shape_px2=self.shape_px2, background_dn=found[:, 3], noise_dn2=found[:, 4])


def _candidates(rough_xy: np.ndarray, found: np.ndarray) -> Candidates:
    n = len(found)
    return Candidates(xy_px=rough_xy, peak_xy=np.rint(rough_xy).astype(np.int64), peak_dn=found[:, 5], flux_dn=found[:, 2],
                      pixels=np.zeros(n, int), elongation=np.ones(n), blend=np.zeros(n, bool))


def _trails(scene: ExpectedScene, candidates: Candidates, trail_px: np.ndarray, reach_px: int, radius: int) -> Centroids:
    patches = scene.patches(candidates.peak_xy, reach_px + radius)
    start = np.column_stack([candidates.xy_px - patches.corner_xy, candidates.flux_dn])
    gain = scene.gain_dn_per_e if np.isfinite(scene.gain_dn_per_e) else 0.0
    fit = fit_trails(patches.signal_dn, patches.floor_variance_dn2, start, moments_of(scene, candidates),
                     np.ascontiguousarray(trail_px), radius, gain)
    return Centroids(xy_px=fit[:, :2] + patches.corner_xy, covariance_px2=fit[:, [2, 4, 4, 3]].reshape(-1, 2, 2),
                     flux_dn=fit[:, 5], background_dn=fit[:, 6], ok=fit[:, 0] == fit[:, 0])
