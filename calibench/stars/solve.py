"""solve: from a raw frame and a map to an attitude, stage by stage, each timed.

1. Spots: raw pixels against the sky's level, centroids in corrected windows.     (find_stars)
   Other detectors than `scan` want the whole frame corrected.                    (calmap, spots)
2. Identification, lost in space, with the map's lens, a given field, or neither.  (lost_in_space)
   The pull of a star's neighbours joins its spot's covariance.                    (crowding)
3. Attitude by the named method without outliers, its covariance and residuals.    (frame_attitude)
4. Where the image's centre looks, with aberration and refraction taken off.       (geometry)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from time import perf_counter

import numpy as np

from ..calmap.correct import correct
from ..geometry import projection, rotation, sphere
from ..records import Attitude, CalibrationMap, Frame, Identification, Intrinsics, Observer, PsfMap, Spots
from ..spots.false_alarms import FALSE_ALARMS
from ..spots.find import find_spots
from .astrometry import as_observed
from .crowding import with_crowding
from .find_stars import FindState, find_stars
from .frame_attitude import attitude_without_outliers, spot_weights
from .lens_error import systematic
from .lost_in_space import LostInSpace
from .per_lens import per_lens
from .view import horizontal_fov

WITHOUT_CORRECTION = "scan"  # the detector that takes raw frames
STAGES = ("correct", "detect", "identify", "attitude")


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

    calibrated: a map gave the lens. systematic_*: what its uncertainty adds, common to all frames of one map: of the attitude
    (3, 3) in camera axes, and of the image's centre (rad, rms of the two axes), computed when first asked for; infinite where
    no map gave the lens.
    """

    file: str
    spots: Spots
    identification: Identification
    attitude: Attitude
    ra_rad: float = np.nan
    dec_rad: float = np.nan
    roll_rad: float = np.nan
    fov_rad: float = np.nan
    calibrated: bool = False
    timings_s: dict[str, float] = field(default_factory=dict)

    @property
    def status(self) -> str:
        return self.attitude.status

    @cached_property
    def _systematic(self) -> tuple[np.ndarray, float]:
        if not self.calibrated or self.status != "solved":
            return np.full((3, 3), np.inf), np.inf
        matrix = rotation.matrix_from_quaternion(self.attitude.q_cam_icrs)
        return systematic(self.identification, matrix, spot_weights(self.identification, calibrated=True))

    @property
    def systematic_covariance_rad2(self) -> np.ndarray:
        return self._systematic[0]

    @property
    def systematic_centre_rad(self) -> float:
        return self._systematic[1]

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
    series: FindState = field(init=False)

    def __post_init__(self) -> None:
        self.series = FindState(k_sigma=self.k_sigma, false_alarms=self.false_alarms, centroider=self.centroider)

    def solve(self, frame: Frame, calmap: CalibrationMap, *, fov_rad: float | None = None,
              observer: Observer | None = None) -> Solution:
        """Solve one raw frame through a map (of nothing, where there is none).

        fov_rad: horizontal field, where the map has no lens. observer: the frame's own, where it is more exact than that of the
        finder's sky.

        Raises:
            BadInput: the frame has another size than the map. UsageError: an unknown detector, centroider, identifier or
                attitude method.
        """
        lens, clock = Lens.of(calmap, fov_rad), [perf_counter()]
        if self.detector == WITHOUT_CORRECTION:
            clock.append(clock[0])
            spots = find_stars(frame, calmap, self.series)
        else:
            corrected = correct(frame, calmap)
            clock.append(perf_counter())
            spots = find_spots(corrected, lens.psf or PsfMap.unknown(frame.image_size_px), psf_known=lens.psf is not None,
                               detector=self.detector, centroider=self.centroider, k_sigma=self.k_sigma,
                               false_alarms=self.false_alarms)
        clock.append(perf_counter())
        return self._from_spots(spots, frame, lens, observer, clock)

    def _from_spots(self, spots: Spots, frame: Frame, lens: Lens, observer: Observer | None, clock: list[float]) -> Solution:
        size = frame.image_size_px
        calibrated = lens.intrinsics is not None
        found = self.finder.identify(spots, size, lens=lens.intrinsics, fov_rad=lens.fov_rad, familiar=self.familiar.get(size))
        clock.append(perf_counter())
        observer = observer or self.finder.sky.observer
        if found.status == "solved":
            found = replace(as_observed(found, self.finder.sky, observer), file=frame.file,
                            covariance_px2=with_crowding(found, self.finder, lens.psf))
            found, attitude = attitude_without_outliers(found, self.attitude_method, calibrated=calibrated)
            if not calibrated:
                self.familiar[size] = found.intrinsics
        else:
            found = replace(found, file=frame.file)
            attitude = Attitude.unsolved(status=found.status, method=self.attitude_method, reason=found.reason)
        pointing = {} if attitude.status != "solved" else pointing_of(found, attitude, observer)
        clock.append(perf_counter())
        timings = dict(zip(STAGES, np.diff(clock).tolist(), strict=True))
        return Solution(file=frame.file, spots=spots, identification=found, attitude=attitude, timings_s=timings,
                        calibrated=calibrated, **pointing)


@per_lens
def _centre_and_above(lens: Intrinsics) -> np.ndarray:
    """Directions (2, 3) of the image's centre and of the pixel above it."""
    w, h = lens.image_size_px
    return projection.unproject(lens, np.array([[(w - 1) / 2, (h - 1) / 2], [(w - 1) / 2, (h - 1) / 2 - 1]]))


def pointing_of(found: Identification, attitude: Attitude, observer: Observer) -> dict[str, float]:
    """Where the image's centre looks, as fields of a Solution: aberration and refraction removed, so that it is where a
    catalogue says."""
    lens = found.intrinsics
    matrix = rotation.matrix_from_quaternion(attitude.q_cam_icrs)
    there, up = sphere.as_catalogued(_centre_and_above(lens) @ matrix, observer)
    ra, dec = sphere.radec_from_unit(there)
    return {"ra_rad": float(ra), "dec_rad": float(dec), "roll_rad": sphere.position_angle(there, up),
            "fov_rad": horizontal_fov(lens)}
