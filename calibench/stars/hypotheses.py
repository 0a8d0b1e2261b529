"""Hypotheses: many possible correspondences of a few spots to a few stars, turned into attitudes and weeded in one go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .sky_catalogue import SkyCatalogue
from .view import TOLERANCE_SIGMA, View

SUPPORT_SPOTS = 14  # the brightest spots asked whether they too stand on a star
SUPPORT_STARS_PER_FIELD = 60
LEAST_SUPPORT = 2
CALIBRATED_MISFIT = 3e-4  # of a pattern's size: focus drift that a calibrated lens is allowed


@dataclass(frozen=True, kw_only=True)
class Hypotheses:
    """spot_rows, star_rows (B, k); rotation (B, 3, 3) R_cam_icrs; scale (B,): true over believed angles; mirrored (B,)."""

    spot_rows: np.ndarray
    star_rows: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray
    mirrored: np.ndarray

    def __len__(self) -> int:
        return len(self.scale)

    def take(self, rows: np.ndarray) -> Hypotheses:
        """The hypotheses of these rows (index or mask), in that order."""
        return Hypotheses(**{f: getattr(self, f)[rows] for f in self.__dataclass_fields__})


def rescaled(directions: np.ndarray, scale: np.ndarray, mirrored: np.ndarray) -> np.ndarray:
    """Directions (B, k, 3) with their angle from the axis stretched by `scale` (B,), x flipped where `mirrored`.

    Tangents are stretched, as another focal length would.
    """
    xy = directions[..., :2] / directions[..., 2:] * scale[:, None, None]
    xy[..., 0] *= np.where(mirrored, -1.0, 1.0)[:, None]
    out = np.concatenate([xy, np.ones_like(xy[..., :1])], -1)
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def _rotations(camera: np.ndarray, sky: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Best R (B, 3, 3) with camera = R sky for (B, k, 3) pairs (SVD), and whether the best orthogonal map is a mirror (B,)."""
    u, _, vt = np.linalg.svd(np.swapaxes(camera, 1, 2) @ sky)
    determinant = np.linalg.det(u @ vt)
    u[..., 2] *= determinant[:, None]
    return u @ vt, determinant < 0


def fit_hypotheses(view: View, sky: SkyCatalogue, spot_rows: np.ndarray, star_rows: np.ndarray) -> Hypotheses:
    """Attitude, scale and handedness of each correspondence (B, k); those that do not fit within tolerance are dropped.

    A calibrated lens is neither mirrored nor off in scale by more than its slack.
    """
    camera, stars = view.directions[spot_rows], sky.directions[star_rows]
    spread = np.linalg.norm(camera - camera.mean(1, keepdims=True), axis=-1).sum(1)
    scale = np.linalg.norm(stars - stars.mean(1, keepdims=True), axis=-1).sum(1) / np.maximum(spread, 1e-12)
    noise = 1 + 3 * np.linalg.norm(view.sigma_rad[spot_rows], axis=1) / np.maximum(spread, 1e-12)
    keep = (scale < (1 + view.scale_slack) * noise) & (scale > 1 / ((1 + view.scale_slack) * noise))
    spot_rows, star_rows, camera, stars, scale = (a[keep] for a in (spot_rows, star_rows, camera, stars, scale))
    if view.calibrated:
        scale = np.ones_like(scale)
    _, mirrored = _rotations(camera, stars)
    camera = rescaled(camera, scale, mirrored)
    rotation, _ = _rotations(camera, stars)
    off = np.linalg.norm(camera - np.einsum("bij,bkj->bki", rotation, stars), axis=-1)
    extent = np.linalg.norm(camera - camera.mean(1, keepdims=True), axis=-1).max(1)
    limit = TOLERANCE_SIGMA * view.sigma_rad[spot_rows] + ((view.ratio_error + CALIBRATED_MISFIT) * extent)[:, None]
    keep = (off < limit).all(1) & ~(mirrored & view.calibrated)
    return Hypotheses(spot_rows=spot_rows[keep], star_rows=star_rows[keep], rotation=rotation[keep], scale=scale[keep],
                      mirrored=mirrored[keep])


def supported(view: View, sky: SkyCatalogue, hypotheses: Hypotheses) -> Hypotheses:
    """Hypotheses under which at least LEAST_SUPPORT further bright spots stand on a star, most supported first."""
    n = min(SUPPORT_SPOTS, len(view.directions))
    if not len(hypotheses):
        return hypotheses
    half_diagonal = view.half_diagonal_rad * (1 + view.scale_slack)
    field = 2 * np.pi * (1 - np.cos(half_diagonal)) * 0.6  # a 4:3 frame fills about 60 % of the circle about it
    brightest = int(min(len(sky.directions), SUPPORT_STARS_PER_FIELD * 4 * np.pi / field))
    tree = cKDTree(sky.directions[:brightest])
    every = np.broadcast_to(view.directions[:n], (len(hypotheses), n, 3))
    camera = rescaled(every, hypotheses.scale, hypotheses.mirrored)
    there = np.einsum("bji,bkj->bki", hypotheses.rotation, camera)
    reach = TOLERANCE_SIGMA * view.sigma_rad[:n] + (view.ratio_error + CALIBRATED_MISFIT) * half_diagonal
    distance, _ = tree.query(there, distance_upper_bound=float(reach.max()))
    hit = distance < reach
    for corner in range(hypotheses.spot_rows.shape[1]):  # the pattern's own corners do not vote
        own = hypotheses.spot_rows[:, corner]
        rows = np.flatnonzero(own < n)
        hit[rows, own[rows]] = False
    votes = hit.sum(1)
    others = n - (hypotheses.spot_rows < n).sum(1)
    order = np.argsort(-votes, kind="stable")
    return hypotheses.take(order[votes[order] >= np.minimum(LEAST_SUPPORT, others[order])])
