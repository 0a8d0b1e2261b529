"""Verify proposed correspondences against all stars in view, and say how likely the agreement is by chance.

1. Each correspondence becomes an attitude (through an unknown lens: with scale and handedness); those beyond tolerance go.
2. The brightest other spots vote: is there a star where each looks?
3. Those with enough votes are compared with all stars in view. M of N spots beyond the hypothesis's own stand on a star;
   each would by chance with probability p_i = stars expected in the circle in which it was sought, at the field's density or
   at that of its neighbourhood if higher. The false-match probability is Poisson's binomial tail P(>= M of N; p_i).
4. A search tries many hypotheses, and each is another draw: the k-th is given the share 1 / (2 k (1 + ln k)^2) of the whole,
   so that the stated probability stays honest however long the search was.

Through a known lens the circles follow from the covariance of centroids, lens, and the hypothesis's attitude. Through an
unknown one the lens is fitted as the match grows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..records import Intrinsics, Spots
from . import kernels
from .guess import kernels as guess
from .sky_catalogue import SkyCatalogue
from .view import CALIBRATED_MISFIT, GUESSED_MODEL_SD_PX, View

ACCEPT = 1e-6  # false-match probability below which a match is believed, where nobody says otherwise
MOST_GROWN = 40  # hypotheses of one guessed lens that are verified in full


@dataclass(frozen=True, kw_only=True)
class Match:
    """spot_rows, star_rows (M,); matrix R_cam_icrs (3, 3); the lens under which they match."""

    spot_rows: np.ndarray
    star_rows: np.ndarray
    matrix: np.ndarray
    intrinsics: Intrinsics
    false_match_probability: float


@dataclass
class Verifier:
    """Judges the proposals for one frame, of one view after the other; keeps count and the best."""

    sky: SkyCatalogue
    spots: Spots
    accept: float = ACCEPT
    tried: int = 0
    best: Match | None = None
    grown: int = 0

    @property
    def done(self) -> bool:
        return self.best is not None and self.best.false_match_probability < self.accept

    def _is_better(self, probability: float) -> bool:
        return self.best is None and probability < 1 or (
            self.best is not None and probability < self.best.false_match_probability)

    def judge(self, view: View, spot_rows: np.ndarray, star_rows: np.ndarray) -> bool:
        """Judge correspondences (B, k) of a view; whether the search in this view is over."""
        spot_rows, star_rows = np.ascontiguousarray(spot_rows, np.int64), np.ascontiguousarray(star_rows, np.int32)
        if not len(spot_rows):
            return False
        return self._known(view, spot_rows, star_rows) if view.calibrated else self._guessed(view, spot_rows, star_rows)

    def _known(self, view: View, spot_rows: np.ndarray, star_rows: np.ndarray) -> bool:
        frame = self.sky.grid, view.field, view.directions, view.sigma_rad
        row, probability, self.tried, matrix, covariance = kernels.judge_known(
            *frame, spot_rows, star_rows, self.tried, self.accept)
        if row >= 0 and self._is_better(probability):
            spot, star, matrix = kernels.final_match(*frame, matrix, covariance)
            self.best = Match(spot_rows=spot, star_rows=star, matrix=matrix, intrinsics=view.intrinsics,
                              false_match_probability=probability)
        return self.done

    def _guessed(self, view: View, spot_rows: np.ndarray, star_rows: np.ndarray) -> bool:
        w, h = view.intrinsics.image_size_px
        middle, half = np.array([(w - 1) / 2, (h - 1) / 2]), np.array([w / 2, h / 2])
        variance = np.trace(self.spots.covariance_px2, axis1=1, axis2=2) / 2 + GUESSED_MODEL_SD_PX**2
        bend = view.ratio_error + CALIBRATED_MISFIT
        votes, matrices, scale, mirrored, fitted = guess.fit_and_vote(
            self.sky.grid, view.field, view.directions, view.sigma_rad, bend, spot_rows, star_rows)
        self.tried += fitted
        order = np.argsort(-votes, kind="stable")
        for row in order[votes[order] >= 0]:
            if self.grown >= MOST_GROWN:
                return True
            self.grown += 1
            seen = view.directions * (-1.0 if mirrored[row] else 1.0, 1.0, 1.0)
            k1, k2 = view.intrinsics.distortion[:2]
            lens = np.array([view.intrinsics.fx_px / scale[row], k1 / scale[row]**2, k2 / scale[row]**4])
            probability, spot, star = guess.grow(
                self.sky.grid, view.field, self.spots.xy_px - middle, variance, seen, lens, matrices[row], mirrored[row], half,
                spot_rows.shape[1], self.tried)
            if self._is_better(probability):
                fitted_lens = Intrinsics(
                    model="brown4", fx_px=lens[0], fy_px=lens[0], cx_px=middle[0], cy_px=middle[1],
                    distortion=np.array([lens[1], lens[2], 0, 0]), image_size_px=(w, h), covariance=np.full((8, 8), np.inf),
                    mirrored=bool(mirrored[row]))
                self.best = Match(spot_rows=spot, star_rows=star, matrix=matrices[row], intrinsics=fitted_lens,
                                  false_match_probability=probability)
            if self.done:
                return True
        return False
