"""The split of a series' errors, against residuals whose parts are known, and what cannot be told."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.geometry import projection
from calibench.records import Identification, Intrinsics, Spots
from calibench.stars.frame_attitude import find_attitude
from calibench.stars.solve import Solution
from calibench.validate.series_errors import split

SIZE = (752, 480)
LENS = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=375.5, cy_px=239.5, distortion=[-0.37, 0.31, 0, 0],
                  image_size_px=SIZE, covariance=np.zeros((8, 8)))


def series(frames, stars, rng, *, field_px=0.0, phase_px=0.0, noise_px=0.05):
    """Frames of random fields: smooth error over the field, error with the place in the pixel, noise; each 1 sigma an axis."""
    out = []
    for _ in range(frames):
        truth = Rotation.random(random_state=rng).as_matrix()
        xy = rng.uniform(5, np.subtract(SIZE, 5), (stars, 2))
        u = 2 * xy / np.array(SIZE) - 1
        smooth = np.stack([u[:, 0]**2 * u[:, 1] - 0.3 * u[:, 1], u[:, 0] * u[:, 1]], -1)
        smooth = smooth / [0.03**0.5, 1 / 3] * field_px  # their rms over the image
        measured = xy + smooth + np.sqrt(2) * phase_px * np.sin(2 * np.pi * xy) + rng.normal(0, noise_px, xy.shape)
        found = Identification(status="solved", method="", spot_rows=np.arange(stars), star_rows=np.arange(stars),
                               xy_px=measured, covariance_px2=np.tile(noise_px**2 * np.eye(2), (stars, 1, 1)),
                               direction_icrs=projection.unproject(LENS, xy) @ truth, intrinsics=LENS)
        attitude = find_attitude(found, "svd", calibrated=True)
        error = Rotation.from_matrix(truth @ Rotation.from_quat(attitude.q_cam_icrs).as_matrix().T).as_rotvec()
        out.append((Solution(file="", spots=Spots.none(), identification=found, attitude=attitude), error))
    return [s for s, _ in out], np.array([e for _, e in out])


@pytest.mark.parametrize(("field_px", "phase_px"), [(0.0, 0.0), (0.08, 0.0), (0.0, 0.04), (0.08, 0.04)])
def test_each_part_is_found_again(field_px, phase_px):
    solutions, errors = series(150, 20, np.random.default_rng(81), field_px=field_px, phase_px=phase_px)
    kinds = {kind.name: kind for kind in split(solutions).kinds}
    assert kinds["temporal noise"].star_px == pytest.approx(0.05, rel=0.1)
    assert kinds["pixel spatial"].star_px == pytest.approx(phase_px, rel=0.15, abs=0.004)
    assert kinds["FOV spatial"].star_px == pytest.approx(field_px, rel=0.15, abs=0.004)
    total = np.sqrt(sum(kinds[n].cross_rad**2 for n in ("FOV spatial", "pixel spatial", "temporal noise")))
    assert total == pytest.approx(np.sqrt((errors[:, :2]**2).mean()), rel=0.25)
    assert kinds["temporal noise"].roll_rad > 3 * kinds["temporal noise"].cross_rad


def test_what_cannot_be_told_says_so():
    few, _ = series(2, 8, np.random.default_rng(82))
    found = split(few)
    kinds = {kind.name: kind for kind in found.kinds}
    assert kinds["FOV spatial"].star_px is None and "too few" in kinds["FOV spatial"].reason
    for name in ("bias", "thermo-elastic"):
        assert kinds[name].star_px is None and "needs" in kinds[name].reason
    assert all(kind.reason for kind in split([]).kinds) and split([]).frames == 0


def test_the_residual_map_shows_a_smooth_error():
    solutions, _ = series(100, 30, np.random.default_rng(83), field_px=0.2)
    found = split(solutions)
    assert found.map_stars.sum() == found.stars == 3000 and len(found.map_xy_px) == 40
    u = 2 * found.map_xy_px / np.array(SIZE) - 1
    assert np.corrcoef(found.map_residual_px[:, 1], u[:, 0] * u[:, 1])[0, 1] > 0.9
