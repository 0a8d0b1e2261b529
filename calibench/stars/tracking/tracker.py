"""Tracker: the attitude of a frame from that of the frame before, and the odds that it is right.

1. Predict: the last attitude, turned on by the rate between the last two.
2. Measure: the brightest stars of the field, each in a window about the place where it must stand, corrected and centred as by
   `solve`; along its trail where the camera turns by more than a fraction of a pixel during the exposure (the middle of a
   trail is its mid-exposure).
3. Fit: rotation by weighted least squares in pixels, outliers out, covariance propagated.
4. Doubt: M of N spots found lie within their own few sigma of a common rotation. One that is no star would by chance with
   p = circle over window; two spots are given to the fit. The binomial tail is the frame's false-match probability.
5. Lost, when that is not below ACCEPT: the answer is `rejected` with the reason, and the caller starts lost in space.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.special import bdtrc

from ...calmap.windows import SeriesLayers
from ...geometry import kernels as geometry_kernels
from ...geometry import projection, rotation
from ...records import Attitude, CalibrationMap, Frame, Identification, Intrinsics, Observer, Spots
from ..kernels import widening
from ..per_lens import lens_terms
from ..sky_catalogue import SkyCatalogue
from ..verify import ACCEPT
from ..view import CALIBRATED_MODEL_SD_PX, GUESSED_MODEL_SD_PX
from . import kernels
from .expected import Expecting
from .lens_drift import LensDrift

MOST_STARS = 24
FEWEST_STARS = 4
MARGIN_RAD = 0.05  # how far the boresight may wander before the field's stars are gathered anew
FIRST_REACH_PX, LEAST_REACH_PX, MOST_REACH_PX = 8, 3, 12
LARGEST_TURN_RAD = 0.1  # between two frames; a larger one is a new target, not a rate
AGREES_SIGMA = 4.0
CROWDED_PX, FAINTER_MAG = 8.0, 4.0  # a star has no neighbour this near that is less than so much fainter
SMALLEST_CIRCLE_PX = 0.3
STALE_VELOCITY_C, STALE_YEARS = 2.5e-8, 1e-7  # 5 mas of aberration; 3 s, in which the zenith moves by 47 arcsec
METHOD = "tracking"


class Field(NamedTuple):
    """Stars about a boresight (3,), brightest first: rows, directions (N, 3) as `observer` sees them."""

    boresight: np.ndarray
    rows: np.ndarray
    directions: np.ndarray
    observer: Observer

    def serves(self, boresight: np.ndarray, observer: Observer) -> bool:
        """Whether these are still the stars of this boresight, seen by this observer."""
        same = observer is self.observer
        moved = 0.0 if same else np.abs(observer.velocity_c - self.observer.velocity_c).max()
        late = observer.refraction is not None and abs(observer.epoch_jyear - self.observer.epoch_jyear) > STALE_YEARS
        return bool(self.boresight @ boresight > np.cos(MARGIN_RAD) and moved < STALE_VELOCITY_C and not late)


@dataclass
class Tracker:
    """Follows one camera through a series. calmap: its map; lens: its intrinsics; calibrated: they come from the map.

    Times are seconds on any one clock, or frame numbers where no clock is known.
    """

    sky: SkyCatalogue
    calmap: CalibrationMap
    lens: Intrinsics
    calibrated: bool
    centroider: str = "psf_map"
    drift: LensDrift = field(init=False)
    rate_rad_s: np.ndarray | None = None
    _matrix: np.ndarray | None = None
    _time_s: float = 0.0
    _reach_px: int = FIRST_REACH_PX
    _started: bool = False
    _field: Field | None = None

    def __post_init__(self) -> None:
        self.drift = LensDrift.of(self.lens)
        self._layers, self._expecting = SeriesLayers(self.calmap), Expecting(calmap=self.calmap, centroider=self.centroider)

    def start(self, q_cam_icrs: np.ndarray, time_s: float) -> None:
        """Begin with a known attitude. The rate follows from two starts in a row, or from the frames tracked; where a track
        broke off, the way from there to here is a jump and no rate."""
        if not self._started:
            self._matrix = self.rate_rad_s = None
        self._moved_to(rotation.matrix_from_quaternion(q_cam_icrs), time_s)
        self._reach_px, self._started = FIRST_REACH_PX, True

    def follow(self, frame: Frame, time_s: float, observer: Observer) -> tuple[Spots, Identification, Attitude]:
        """Spots, identification and attitude of the next frame; status `rejected` where the track is lost.

        Raises:
            BadInput: the frame has another size than the map. UsageError: unknown centroider.
        """
        lens = self.drift.applied_to(self.lens)
        matrix, turning = self._predicted(time_s)
        rows, directions, xy, by_v = self._expected(lens, matrix, turning, observer)
        trail = _trails(by_v, directions, matrix, turning * (frame.exposure_s or 0.0))
        seen, spots = self._expecting.measure(frame.data, self._layers.of(frame), xy, trail, self._reach_px)
        if len(seen) < FEWEST_STARS:
            return self._lost(spots, f"{len(seen)} of {len(rows)} stars were seen in their windows")
        return self._fitted(spots, rows[seen], directions[seen], by_v[seen], matrix, lens, time_s)

    def _predicted(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Attitude and rate (camera axes, rad/s; zero where unknown) at a time."""
        rate = np.zeros(3) if self.rate_rad_s is None else self.rate_rad_s
        matrix = self._matrix.copy()
        geometry_kernels.turn_by(-rate * (time_s - self._time_s), matrix)
        return matrix, rate

    def _expected(self, lens: Intrinsics, matrix: np.ndarray, rate: np.ndarray,
                  observer: Observer) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The brightest stars of the field: rows (N,), directions (N, 3), pixels (N, 2), Jacobians by direction (N, 2, 3); of a
        rolling shutter as each star's row sees it."""
        w, h = lens.image_size_px
        if self._field is None or not self._field.serves(matrix[2], observer):
            corners = projection.unproject(lens, np.array([[0.0, 0], [w - 1, 0], [0, h - 1], [w - 1, h - 1]]))
            radius = float(np.arccos(np.clip(corners[:, 2], -1, 1)).max()) + MARGIN_RAD
            rows = _alone(self.sky, self.sky.near(matrix[2], radius), CROWDED_PX / lens.fx_px)
            self._field = Field(matrix[2].copy(), rows, self.sky.seen_at(rows, observer), observer)
        chosen, xy, by_v = self._on_frame(lens, matrix)
        directions = self._field.directions[chosen]
        if observer.rolling is not None:
            stated = observer.rolling.rate_rad_s
            late_s = (xy[:, 1] - observer.rolling.middle_row) * observer.rolling.row_time_s
            turn = rotation.matrix_from_rotvec(-late_s[:, None] * (stated if stated.any() else rate))
            directions = np.einsum("ji,mjk,mk->mi", matrix, turn, directions @ matrix.T)
            xy, by_v, _ = projection.project_with_jacobian(lens, directions @ matrix.T)
        return self._field.rows[chosen], directions, xy, by_v

    def _on_frame(self, lens: Intrinsics, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The brightest of the field's stars whose windows lie on the frame: places in the field, pixels, Jacobians."""
        w, h = lens.image_size_px
        if not lens.is_fisheye:
            camera, terms, _, fold = lens_terms(lens)
            return kernels.predict(self._field.directions, matrix, camera, terms, fold, w, h, self._reach_px, MOST_STARS)
        u = self._field.directions @ matrix.T
        xy = projection.project(lens, u) - self._reach_px
        chosen = np.flatnonzero(((xy > 0) & (xy < np.array([w, h]) - 1 - 2 * self._reach_px)).all(1))[:MOST_STARS]
        xy, by_v, _ = projection.project_with_jacobian(lens, u[chosen])
        return chosen, xy, by_v

    def _fitted(self, spots: Spots, rows: np.ndarray, directions: np.ndarray, by_v: np.ndarray, matrix: np.ndarray,
                lens: Intrinsics, time_s: float) -> tuple[Spots, Identification, Attitude]:
        model_sd = CALIBRATED_MODEL_SD_PX if self.calibrated else GUESSED_MODEL_SD_PX
        covariance = np.ascontiguousarray(spots.covariance_px2.reshape(-1, 4)[:, [0, 3, 1]])
        circle = np.maximum(AGREES_SIGMA * np.sqrt(covariance[:, :2].mean(1) + model_sd**2), SMALLEST_CIRCLE_PX)
        v = geometry_kernels.unproject(*lens_terms(lens), spots.xy_px)
        fitted = np.ascontiguousarray(matrix)
        agreeing, residual, by_turn, weight = kernels.fit_track(v, directions, by_v, covariance, model_sd, circle, FEWEST_STARS,
                                                                fitted)
        kept = np.flatnonzero(agreeing)
        matches, n = len(kept), len(rows)
        chance = min(float(np.mean(np.pi * circle**2)) / (2 * self._reach_px + 1) ** 2, 1.0)
        odds = float(bdtrc(matches - 3, n - 2, chance)) if matches > 2 else 1.0
        if matches < FEWEST_STARS or odds >= ACCEPT:
            return self._lost(spots, f"{matches} of {n} stars agree on a rotation, by chance with probability {odds:.2g}", odds)
        residual, own = residual[kept], covariance[kept] + (0 if self.calibrated else model_sd**2) * np.array([1, 1, 0])
        spread, chi2, information, gradient = kernels.spread_of(
            residual, by_turn[kept], weight[kept], own, spots.xy_px[kept], np.array([lens.cx_px, lens.cy_px]))
        freedom = 2 * matches - 3
        scale = widening(chi2, freedom)
        self.drift = self.drift.after(information, gradient)
        self._follow_closely(lens, matrix, fitted)
        self._moved_to(fitted, time_s)
        self._started = False
        attitude = Attitude(status="solved", method=METHOD, q_cam_icrs=rotation.quaternion_from_matrix(fitted),
                            covariance_rad2=spread * scale, residual_px=residual)
        identification = Identification(
            status="solved", method=METHOD, spot_rows=kept, star_rows=rows[kept], xy_px=spots.xy_px[kept],
            covariance_px2=spots.covariance_px2[kept], direction_icrs=directions[kept], false_match_probability=odds,
            intrinsics=lens)
        return spots, identification, attitude

    def _follow_closely(self, lens: Intrinsics, predicted: np.ndarray, fitted: np.ndarray) -> None:
        """The next windows are as wide as twice what this prediction missed by (cross-boresight, and roll at the corner)."""
        turn = np.abs(fitted @ predicted.T - np.eye(3))
        moved_px = lens.fx_px * max(turn[0, 2], turn[1, 2]) + turn[0, 1] * max(lens.image_size_px) / 2
        self._reach_px = min(math.ceil(2 * moved_px + LEAST_REACH_PX), MOST_REACH_PX)

    def _moved_to(self, matrix: np.ndarray, time_s: float) -> None:
        if self._matrix is not None and time_s > self._time_s:
            turn = rotation.rotvec_from_matrix(matrix @ self._matrix.T)
            self.rate_rad_s = -turn / (time_s - self._time_s) if math.hypot(*turn.tolist()) < LARGEST_TURN_RAD else None
        self._matrix, self._time_s = matrix, time_s

    def _lost(self, spots: Spots, why: str, odds: float = 1.0) -> tuple[Spots, Identification, Attitude]:
        reason = f"track lost: {why}"
        return spots, Identification(status="rejected", method=METHOD, reason=reason, false_match_probability=odds), (
            Attitude.unsolved(status="rejected", method=METHOD, reason=reason))


def _alone(sky: SkyCatalogue, rows: np.ndarray, reach_rad: float) -> np.ndarray:
    """Of these rows the stars without a neighbour in reach that could pull their centroid."""
    v, magnitude = sky.directions[rows], sky.magnitude[rows]
    near = np.linalg.norm(v[:, None] - v[None], axis=-1) < reach_rad
    pulls = near & (magnitude[None] < magnitude[:, None] + FAINTER_MAG)
    return rows[pulls.sum(1) == 1]


def _trails(by_v: np.ndarray, directions: np.ndarray, matrix: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    """What each star's image moves during an exposure (N, 2), px."""
    if not turn_rad.any():
        return np.zeros((len(directions), 2))
    return np.einsum("nij,nj->ni", by_v, directions @ (matrix.T @ rotation.skew(turn_rad)))
