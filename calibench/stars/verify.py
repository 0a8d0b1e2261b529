"""Verify one hypothesis against all stars in view, and say how likely the agreement is by chance.

1. Project the brightest catalogue stars of the field through the hypothesis.
2. Match them with the brightest spots: mutual nearest neighbours within a radius.
3. Fit attitude (and lens, where no map gave one) to the matches; shrink the radius; repeat.
4. With M matches of N spots beyond those that made the hypothesis, each with the chance p = stars x circle / frame of
   standing near a star anyway, the false-match probability is the binomial tail P(>= M of N; p) times the number of
   hypotheses tried (Bonferroni), so that it stays honest however long the search was.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import bdtrc

from ..geometry import projection
from ..records import Intrinsics
from .hypotheses import Hypotheses
from .refine import Refined, refine
from .sky_catalogue import SkyCatalogue
from .view import View

VERIFY_SPOTS = 60
STARS_PER_SPOT = 1.5
FEWEST_STARS = 25
GUESSED_RADIUS = 0.010  # of the half diagonal: how far an unfitted lens may throw a star at first
GUESSED_ROUNDS, CALIBRATED_ROUNDS = 5, 3
SMALLEST_RADIUS_PX = 1.0
GUESSED_MODEL_SD_PX, CALIBRATED_MODEL_SD_PX = 0.15, 0.03


@dataclass(frozen=True, kw_only=True)
class Match:
    """spot_rows, star_rows (M,); refined fit; false_match_probability."""

    spot_rows: np.ndarray
    star_rows: np.ndarray
    refined: Refined
    false_match_probability: float


def stars_in_frame(lens: Intrinsics, matrix: np.ndarray, sky: SkyCatalogue, half_diagonal: float,
                   most: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows (K,) of the brightest catalogue stars that fall on the frame and their pixels (K, 2)."""
    w, h = lens.image_size_px
    rows = sky.near(matrix[2], half_diagonal)
    xy = projection.project(lens, sky.directions[rows] @ matrix.T)
    on = (xy[:, 0] > -0.5) & (xy[:, 0] < w - 0.5) & (xy[:, 1] > -0.5) & (xy[:, 1] < h - 0.5)
    return rows[on][:most], xy[on][:most]


def stars_for(spots: int) -> int:
    """How many catalogue stars are asked for so many spots."""
    return max(FEWEST_STARS, int(STARS_PER_SPOT * spots))


def pair_up(spots_xy: np.ndarray, stars_xy: np.ndarray, radius_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Mutual nearest neighbours within radius_px: rows into the spots and into the stars."""
    distance, star = cKDTree(stars_xy).query(spots_xy, distance_upper_bound=radius_px)
    _, spot = cKDTree(spots_xy).query(stars_xy)
    near = np.flatnonzero(np.isfinite(distance))
    near = near[spot[star[near]] == near]
    return near, star[near]


def chance(matches: int, spots: int, stars: int, radius_px: float, size_px: tuple[int, int], corners: int, tried: int) -> float:
    """False-match probability of step 4 above."""
    p = min(1.0, stars * np.pi * radius_px**2 / (size_px[0] * size_px[1]))
    extra, others = matches - corners, spots - corners
    return 1.0 if extra <= 0 else float(min(1.0, bdtrc(extra - 1, others, p) * max(tried, 1)))


def verify(view: View, covariance_px2: np.ndarray, sky: SkyCatalogue, hypothesis: Hypotheses, tried: int) -> Match | None:
    """The match that grows from one hypothesis (a Hypotheses of length 1), or None when the spots do not follow.

    covariance_px2: (N, 2, 2) of all the view's spots. tried: hypotheses tested so far, for the Bonferroni factor.
    """
    lens, scale = view.intrinsics, float(hypothesis.scale[0])
    lens = replace(lens, fx_px=lens.fx_px / scale, fy_px=lens.fy_px / scale,
                   mirrored=lens.mirrored ^ bool(hypothesis.mirrored[0]))
    matrix, size = hypothesis.rotation[0], lens.image_size_px
    every, judged = len(view.xy_px), min(VERIFY_SPOTS, len(view.xy_px))
    n = judged
    half_diagonal = view.half_diagonal_rad * 1.1 * max(scale, 1.0)
    half_px = np.hypot(*size) / 2
    sigma_px = float(np.median(view.sigma_rad[:n])) * lens.fx_px
    radius = 4 * sigma_px + (1.0 if view.calibrated else GUESSED_RADIUS * half_px)
    model_sd = CALIBRATED_MODEL_SD_PX if view.calibrated else GUESSED_MODEL_SD_PX
    corners = hypothesis.spot_rows.shape[1]
    rounds = CALIBRATED_ROUNDS if view.calibrated else GUESSED_ROUNDS
    for turn in range(rounds):
        if turn == rounds - 1:  # the last round takes every spot and as many stars
            n = every
        rows, stars_xy = stars_in_frame(lens, matrix, sky, half_diagonal, stars_for(n))
        if len(rows) < corners:
            return None
        spot, star = pair_up(view.xy_px[:n], stars_xy, radius)
        if len(spot) < corners:
            return None
        refined = refine(lens, matrix, view.xy_px[spot], covariance_px2[spot], sky.directions[rows[star]],
                         free_lens=not view.calibrated, model_sd_px=model_sd)
        lens, matrix = refined.intrinsics, refined.rotation
        off = np.hypot(*refined.residual_px.T)
        rms = 1.48 * np.nanmedian(off) / 1.25  # of one axis, from the median length (Rayleigh)
        probability_radius = radius
        radius = max(SMALLEST_RADIUS_PX, min(radius, 5 * rms))
    keep = off < radius
    spot, rows_kept = spot[keep], rows[star[keep]]
    counted_stars = min(len(rows), stars_for(judged))
    agreeing = int(((spot < judged) & (star[keep] < counted_stars)).sum())
    probability = chance(agreeing, judged, counted_stars,
                         max(radius, min(probability_radius, 2 * radius)), size, corners, tried)
    refined = replace(refined, residual_px=refined.residual_px[keep])
    return Match(spot_rows=spot, star_rows=rows_kept, refined=refined, false_match_probability=probability)
