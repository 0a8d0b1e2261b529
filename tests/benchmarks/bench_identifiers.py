"""All identifiers and all attitude methods beside each other. `make bench`; CALIBENCH_ATTITUDES: frames a condition (300).

CPU time of this process; what is asserted is what must hold on any machine.
"""

from __future__ import annotations

import os
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench import registry
from calibench.io.star_table import load_star_table
from calibench.records import CalibrationMap, Intrinsics, Observer
from calibench.stars.frame_attitude import find_attitude
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.validate.simulated_spots import Condition, look
from calibench.validate.trials import identifiers

FRAMES = int(os.environ.get("CALIBENCH_ATTITUDES", 300))
LENS = Intrinsics.pinhole(focal_px=1416.7, image_size_px=(752, 480), focal_sd_px=0.0)
CALMAP = CalibrationMap(image_size_px=(752, 480), intrinsics=LENS, measured=frozenset({"intrinsics"}))


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    return SkyCatalogue.seen_by(load_star_table(), Observer())


def test_identifiers(sky, monkeypatch):
    monkeypatch.setattr(identifiers, "FRAMES", FRAMES)
    found, _ = identifiers.trial([None], CALMAP, lambda case: LostInSpace(sky=sky))
    print(f"\n{'  '.join(found.columns)}")
    for row in found.rows:
        print("  ".join(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row))
    assert sum(row[found.columns.index("wrong")] for row in found.rows) == 0


def test_attitude_methods(sky):
    """Error about each axis, arcsec rms; normalised error squared, mean of the axes; CPU time of method and covariance."""
    finder, cases = LostInSpace(sky=sky), []
    for seed in range(FRAMES):
        truth, spots = look(sky, LENS, Condition(), np.random.default_rng([8, seed]))
        found = finder.identify(spots, LENS.image_size_px, lens=LENS)
        if found.status == "solved":
            cases.append((truth, found))
    print(f"\n{len(cases)} frames\nmethod  x  y  roll arcsec  NEES  ms")
    for method in registry.names("calibench.stars.attitude"):
        find_attitude(cases[0][1], method, calibrated=True)
        begin = time.process_time()
        made = [find_attitude(found, method, calibrated=True) for _, found in cases]
        ms = 1e3 * (time.process_time() - begin) / len(cases)
        error = np.array([Rotation.from_matrix(truth @ Rotation.from_quat(one.q_cam_icrs).as_matrix().T).as_rotvec()
                          for (truth, _), one in zip(cases, made, strict=True)])
        nees = np.mean([e @ np.linalg.solve(one.covariance_rad2, e) / 3 for e, one in zip(error, made, strict=True)])
        rms = np.degrees(np.sqrt((error**2).mean(0))) * 3600
        print(f"{method:9} {rms[0]:6.1f} {rms[1]:6.1f} {rms[2]:6.1f} {nees:6.2f} {ms:6.3f}")
        assert 0.5 < nees < 1.5
