"""solve: from a corrected frame to an attitude, stage by stage, each timed.

1. Spots: background, detection, centroids with covariance.                       (spots)
2. Identification, lost in space, with the map's lens, a given field, or neither.  (lost_in_space)
3. Attitude by the named method without outliers, its covariance and residuals.    (frame_attitude)
4. Where the image's centre looks, with aberration and refraction taken off.       (geometry)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from ..geometry import projection, rotation, sphere
from ..records import Attitude, CalibrationMap, CorrectedFrame, Frame, Identification, Intrinsics, Observer, PsfMap, Spots
from ..spots.find import FALSE_ALARMS, find_spots
from .astrometry import as_observed
from .find_stars import FindState, find_stars
from .frame_attitude import attitude_without_outliers, spot_weights
from .lens_error import systematic
from .lost_in_space import LostInSpace
from .per_lens import per_lens
from .view import horizontal_fov


@dataclass(frozen=True, kw_only=True)
class Lens:
    """What the caller knows of the lens and the PSF: measured ones, or None. fov_rad: horizontal field given by hand."""

    intrinsics: Intrinsics | None = None
    psf: PsfMap | None = None
    fov_rad: float | None = None

    @classmethod
    def of(cls, calmap: CalibrationMap, fov_rad: float | None = None) -> Lens:
        """What a map knows; its unmeasured layers are None here, so that solving falls back to a guess knowingly."""
        return cls(intrinsics=calmap.intrinsics if "intrinsics" in calmap.measured else None,
                   psf=calmap.psf if "psf" in calmap.measured else None, fov_rad=fov_rad)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """One frame's way through the sky wing. ra, dec, roll: of the image's centre, NaN without a solution.

    systematic_*: what the lens's uncertainty adds, common to all frames of one map: of the attitude (3, 3) in camera axes,
    and of the image's centre (rad, rms of the two axes); infinite where no map gave the lens.
    """

    file: str
    spots: Spots
    identification: Identification
    attitude: Attitude
    ra_rad: float = np.nan
    dec_rad: float = np.nan
    roll_rad: float = np.nan
    fov_rad: float = np.nan
    systematic_covariance_rad2: np.ndarray = field(default_factory=lambda: np.full((3, 3), np.inf))
    systematic_centre_rad: float = np.inf
    timings_s: dict[str, float] = field(default_factory=dict)

    @property
    def status(self) -> str:
        return self.attitude.status

    @property
    def sigma_cross_rad(self) -> float:
        """1-sigma of the boresight direction, rms of the two cross-boresight axes."""
        return float(np.sqrt(np.trace(self.attitude.covariance_rad2[:2, :2]) / 2))

    @property
    def sigma_roll_rad(self) -> float:
        return float(np.sqrt(self.attitude.covariance_rad2[2, 2]))


@dataclass
class Solver:
    """Solves the frames of a series one after the other; a lens fitted to one frame is the first guess for the next."""

    finder: LostInSpace
    attitude_method: str = "quest"
    detector: str = "scan"
    centroider: str = "psf_map"
    k_sigma: float | None = None
    false_alarms: float = FALSE_ALARMS
    familiar: dict[tuple[int, int], Intrinsics] = field(default_factory=dict)
    series: FindState = field(default_factory=FindState)

    def solve(self, corrected: CorrectedFrame, lens: Lens, observer: Observer | None = None) -> Solution:
        """Solve one corrected frame. observer: the frame's own, where it is more exact than that of the finder's sky.

        Raises:
            UsageError: an unknown detector, centroider, identifier or attitude method.
        """
        size, start = corrected.signal_dn.shape[::-1], perf_counter()
        spots = find_spots(corrected, lens.psf or PsfMap.unknown(size), psf_known=lens.psf is not None,
                           detector=self.detector, centroider=self.centroider, k_sigma=self.k_sigma,
                           false_alarms=self.false_alarms)
        return self._from_spots(spots, size, corrected.file, lens, observer, [start, perf_counter()])

    def solve_raw(self, frame: Frame, calmap: CalibrationMap, observer: Observer | None = None) -> Solution:
        """Solve one raw frame of a series through the map, fast: only the windows about its spots are corrected (find_stars).

        Raises:
            BadInput: the frame has another size than the map. UsageError: an unknown identifier or attitude method.
        """
        start = perf_counter()
        spots = find_stars(frame, calmap, self.series)
        return self._from_spots(spots, frame.image_size_px, frame.file, Lens.of(calmap), observer, [start, perf_counter()])

    def _from_spots(self, spots: Spots, size: tuple[int, int], file: str, lens: Lens, observer: Observer | None,
                    clock: list[float]) -> Solution:
        found = self.finder.identify(spots, size, lens=lens.intrinsics, fov_rad=lens.fov_rad, familiar=self.familiar.get(size))
        found = replace(found, file=file)
        clock.append(perf_counter())
        observer = observer or self.finder.sky.observer
        if found.status == "solved":
            found = as_observed(found, self.finder.sky.table, observer)
            found, attitude = attitude_without_outliers(found, self.attitude_method, calibrated=lens.intrinsics is not None)
            if lens.intrinsics is None:
                self.familiar[size] = found.intrinsics
        else:
            attitude = Attitude.unsolved(status=found.status, method=self.attitude_method, reason=found.reason)
        clock.append(perf_counter())
        timings = dict(zip(("detect", "identify", "attitude"), np.diff(clock).tolist(), strict=True))
        solution = Solution(file=file, spots=spots, identification=found, attitude=attitude, timings_s=timings)
        return completed(solution, observer, calibrated=lens.intrinsics is not None)


def completed(solution: Solution, observer: Observer, *, calibrated: bool) -> Solution:
    """With what follows from a solved attitude: the systematic error of a map's lens, and where the image's centre looks."""
    found, attitude = solution.identification, solution.attitude
    if attitude.status != "solved":
        return solution
    if calibrated:
        matrix = rotation.matrix_from_quaternion(attitude.q_cam_icrs)
        bias, centre = systematic(found, matrix, spot_weights(found, calibrated=True))
        solution = replace(solution, systematic_covariance_rad2=bias, systematic_centre_rad=centre)
    return _pointed(solution, observer)


@per_lens
def _centre_and_above(lens: Intrinsics) -> np.ndarray:
    """Directions (2, 3) of the image's centre and of the pixel above it."""
    w, h = lens.image_size_px
    return projection.unproject(lens, np.array([[(w - 1) / 2, (h - 1) / 2], [(w - 1) / 2, (h - 1) / 2 - 1]]))


def _pointed(solution: Solution, observer: Observer) -> Solution:
    """With the sky direction of the image's centre: aberration and refraction removed, so that it is where a catalogue says."""
    lens = solution.identification.intrinsics
    centre, above = _centre_and_above(lens)
    matrix = rotation.matrix_from_quaternion(solution.attitude.q_cam_icrs)
    there, up = (sphere.as_catalogued(matrix.T @ v, observer) for v in (centre, above))
    ra, dec = sphere.radec_from_unit(there)
    return replace(solution, ra_rad=float(ra), dec_rad=float(dec), roll_rad=sphere.position_angle(there, up),
                   fov_rad=horizontal_fov(lens))
