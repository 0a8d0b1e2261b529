"""Attitude methods: every one on the same identified frames of the map's camera, over noise, false, missing and few stars.

The frames are those of the trial `identifiers`, identified by `pattern`. A method's attitude is made as `solve` makes it,
stars that miss left out. NEES: error squared in units of its covariance, mean of the three axes; 1 where the error bars are
right. CPU time of this process, with covariance and residuals.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ... import registry
from ...geometry import rotation
from ...records import Attitude, CalibrationMap, Identification
from ...stars.frame_attitude import attitude_without_outliers
from ...stars.lost_in_space import LostInSpace
from ..case import ARCSEC, SkyCase, Trial, the_lens
from ..simulated_spots import bright_sky, look, variants

FRAMES = 40  # of each condition
COLUMNS = ("condition", "method", "frames", "solved", "cross_arcsec", "roll_arcsec", "nees", "cpu_ms")


def trial(cases: Sequence[SkyCase], calmap: CalibrationMap, finders: Callable[[SkyCase], LostInSpace],
          settings: dict | None = None, tick: Callable[[], None] = lambda: None) -> tuple[Trial, dict]:
    """The table of conditions by methods. cases: their first frame says whose sky is taken.

    Raises:
        BadInput: the map has no lens.
    """
    lens = the_lens(calmap, "the comparison of attitude methods")
    finder, rows = LostInSpace(sky=bright_sky(finders(cases[0]).sky)), []
    for name, condition in variants(calmap).items():
        frames = []
        for seed in range(FRAMES):
            truth, spots = look(finder.sky, lens, condition, np.random.default_rng([8, seed]))
            found = finder.identify(spots, lens.image_size_px, lens=lens)
            if found.status == "solved":
                frames.append((truth, found))
        if frames:
            rows += [(name, method, len(frames), *_figures(frames, method))
                     for method in registry.names("calibench.stars.attitude")]
        tick()
    reading = ("every attitude method on the same identified frames; errors against the simulated attitude, rms; NEES is 1 "
               "where the error bars are right")
    return Trial(name="attitude_methods", columns=COLUMNS, rows=tuple(rows), reading=reading), {}


def _figures(frames: Sequence[tuple[np.ndarray, Identification]], method: str) -> tuple[int, float, float, float, float]:
    """Attitudes made, errors across and about the boresight (arcsec), NEES, CPU ms a frame."""
    attitude_without_outliers(frames[0][1], method, calibrated=True)  # compiles
    begin = time.process_time()
    made = [attitude_without_outliers(found, method, calibrated=True)[1] for _, found in frames]
    ms = 1e3 * (time.process_time() - begin) / len(frames)
    solved = [(_error_rad(truth, one), one) for (truth, _), one in zip(frames, made, strict=True) if one.status == "solved"]
    if not solved:
        return 0, np.nan, np.nan, np.nan, ms
    x, y, roll = np.sqrt(np.mean([error**2 for error, _ in solved], axis=0)) * ARCSEC
    nees = np.mean([error @ np.linalg.solve(one.covariance_rad2, error) / 3 for error, one in solved])
    return len(solved), float(np.hypot(x, y) / np.sqrt(2)), float(roll), float(nees), ms


def _error_rad(truth: np.ndarray, attitude: Attitude) -> np.ndarray:
    """Rotation vector (3,), camera axes, from the attitude to the truth."""
    return rotation.rotvec_from_matrix(truth @ rotation.matrix_from_quaternion(attitude.q_cam_icrs).T)
