"""Shapes of the point sources on one frame: which spots can be trusted, and the Gaussian that fits each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...records import SPOT_FLAGS, UNUSABLE, CorrectedFrame, PsfMap
from ...spots.background import background_and_noise
from ...spots.cut import cut
from ...spots.find import find_spots
from ...spots.gaussian_fit import fit_gaussians
from .epsf import Windows

START_SIGMA_PX = 1.0
SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX = 4, 12
WORST_ELONGATION = 3.0
UNSETTLED_PX = 0.1


@dataclass(frozen=True, kw_only=True)
class SpotShapes:
    """Usable spots of one frame and why the others are not.

    xy_px (N, 2); moments_px2 (N, 3) s_xx, s_yy, s_xy of the PSF without the pixel; flux_dn (N,); distance_px and light (N, M):
    each window pixel's distance from the centre and its share of the spot's flux (NaN where it cannot be used).
    rejected: reason -> count. windows: the spots cut out, for the shape's fit. detected_xy_px (M, 2): usable or not.
    """

    xy_px: np.ndarray
    moments_px2: np.ndarray
    flux_dn: np.ndarray
    distance_px: np.ndarray
    light: np.ndarray
    rejected: dict[str, int]
    windows: Windows
    detected_xy_px: np.ndarray

    def take(self, rows: np.ndarray) -> SpotShapes:
        """The spots of these rows; why others were set aside stays as it was."""
        arrays = {name: getattr(self, name)[rows] for name in ("xy_px", "moments_px2", "flux_dn", "distance_px", "light")}
        return SpotShapes(**arrays, rejected=self.rejected, windows=self.windows.take(rows),
                          detected_xy_px=self.detected_xy_px)


def shapes(corrected: CorrectedFrame, image_size_px: tuple[int, int], *, k_sigma: float, least_snr: float,
           radius_px: int | None = None, counted: np.ndarray | None = None) -> SpotShapes:
    """Find spots, sort out those that would spoil a shape, fit a free Gaussian to each of the rest.

    radius_px: half width of the windows; None: three sigma of this frame's own spots. counted: (H, W) bool, pixels of one
    colour of a mosaic, the only ones that weigh in the fit (spots are found on all). The fit integrates the Gaussian over each
    pixel, so its moments are those of the light before the pixel.
    """
    spots = find_spots(corrected, PsfMap.unknown(image_size_px), k_sigma=k_sigma)
    unusable = ((corrected.defects & UNUSABLE) != 0) | ~np.isfinite(corrected.signal_dn)
    background, noise = background_and_noise(corrected.signal_dn, unusable)
    signal = np.where(unusable, 0, corrected.signal_dn - background)
    rough = np.clip(np.rint(spots.xy_px).astype(int), 0, np.array(image_size_px) - 1)
    snr = spots.peak_dn / noise[rough[:, 1], rough[:, 0]]

    unusable = unusable if counted is None else unusable | ~counted

    # A first fit in a small window tells the size, the second uses a window of three sigma.
    gain = corrected.gain_dn_per_e
    floor = noise.astype(float) ** 2
    start = np.tile([START_SIGMA_PX**2, START_SIGMA_PX**2, 0.0], (len(spots), 1))
    first = fit_gaussians(signal, floor, unusable, spots.xy_px, start, gain_dn_per_e=gain, radius=SMALLEST_RADIUS_PX,
                          free_shape=True)
    good = first.converged & (snr > least_snr)
    width = np.sqrt(np.median(first.moments_px2[good][:, :2])) if good.any() else START_SIGMA_PX
    radius = radius_px or int(np.clip(np.ceil(3 * width + 2), SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX))
    fit = fit_gaussians(signal, floor, unusable, spots.xy_px, np.where(good[:, None], first.moments_px2, start),
                        gain_dn_per_e=gain, radius=radius, free_shape=True)

    x, y = spots.xy_px.T
    w, h = image_size_px
    distance = cKDTree(spots.xy_px).query(spots.xy_px, k=2)[0][:, 1] if len(spots) > 1 else np.full(len(spots), np.inf)
    major, minor = axes_px(np.nan_to_num(fit.moments_px2, nan=1.0))
    reasons = {
        "saturated": (spots.flags & SPOT_FLAGS["saturated"]) != 0,
        "at the edge": (x < radius) | (y < radius) | (x > w - 1 - radius) | (y > h - 1 - radius),
        "on a defect": (spots.flags & SPOT_FLAGS["defect"]) != 0,
        "too near to another": distance < 2 * radius,
        f"fainter than {least_snr:g} sigma": ~(snr > least_snr),
        "no point source (fit failed, a single hot pixel, or drawn out)":
            ~fit.converged | (minor < 0.15) | (major > WORST_ELONGATION * np.maximum(minor, 0.3)),
    }
    if counted is not None:
        variance = np.maximum(fit.covariance[:, 0, 0], fit.covariance[:, 1, 1])
        reasons["not settled by the pixels of one colour"] = ~(variance < UNSETTLED_PX**2)
    usable, rejected = np.ones(len(spots), bool), {}
    for reason, bad in reasons.items():
        rejected[reason] = int((usable & bad).sum())
        usable &= ~bad
    centres = rough[usable]
    data = cut(np.where(unusable, np.nan, signal).astype(float), centres, radius, np.nan)
    along = np.arange(-radius, radius + 1) + (centres - fit.xy_px[usable])[:, :, None]
    flat = len(data), (2 * radius + 1) ** 2
    distance = np.hypot(along[:, 0, None, :], along[:, 1, :, None]).reshape(flat)
    light = (data.reshape(flat) - fit.background_dn[usable][:, None]) / fit.flux_dn[usable][:, None]
    good = np.isfinite(data)
    cut_out = Windows(data_dn=np.where(good, data, 0), good=good, corner_xy=centres - radius,
                      floor_dn2=cut(floor, centres, radius, np.nan), xy_px=fit.xy_px[usable], flux_dn=fit.flux_dn[usable],
                      background_dn=fit.background_dn[usable])
    return SpotShapes(xy_px=fit.xy_px[usable], moments_px2=fit.moments_px2[usable], flux_dn=fit.flux_dn[usable],
                      distance_px=distance, light=light, rejected=rejected, windows=cut_out, detected_xy_px=spots.xy_px)


def axes_px(moments_px2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sigma along the major and the minor axis, (N,) each, from moments (N, 3)."""
    s_xx, s_yy, s_xy = moments_px2.T
    middle, half = (s_xx + s_yy) / 2, np.hypot((s_xx - s_yy) / 2, s_xy)
    return np.sqrt(middle + half), np.sqrt(np.maximum(middle - half, 0))
