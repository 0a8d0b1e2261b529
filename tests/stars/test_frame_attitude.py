"""The attitude of an identified frame: honest covariance for every method, outliers, and frames that determine no rotation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from calibench import registry
from calibench.geometry import projection
from calibench.records import Identification, Intrinsics
from calibench.stars.frame_attitude import attitude_without_outliers, find_attitude

METHODS = registry.names("calibench.stars.attitude")
SIZE = (752, 480)
LENS = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=379.0, cy_px=236.0, distortion=[-0.37, 0.31, -1e-3, 3e-4],
                  image_size_px=SIZE, covariance=np.zeros((8, 8)))


def frame(rng, stars=20, *, sd_px=(0.03, 0.3), worse=1.0, lens=LENS):
    """An identified frame of known truth; spots with their own round errors, `worse` times as large as stated."""
    truth = Rotation.random(random_state=rng).as_matrix()
    xy = rng.uniform(5, np.subtract(SIZE, 5), (stars, 2))
    sd = np.exp(rng.uniform(*np.log(sd_px), stars))
    sky = projection.unproject(lens, xy) @ truth
    rows = np.arange(stars)
    return truth, Identification(status="solved", method="", spot_rows=rows, star_rows=rows, direction_icrs=sky,
                                 intrinsics=lens, xy_px=xy + rng.normal(size=(stars, 2)) * sd[:, None] * worse,
                                 covariance_px2=sd[:, None, None]**2 * np.eye(2))


def error(attitude, truth):
    """Rotation vector d, camera axes, with R_true = exp(d) R."""
    return Rotation.from_matrix(truth @ Rotation.from_quat(attitude.q_cam_icrs).as_matrix().T).as_rotvec()


@pytest.mark.parametrize("method", METHODS)
def test_covariance_is_honest_for_every_method(method):
    """Normalised error squared by axis over 400 frames with spots of very different errors: 1 within the 99.9 % of chance."""
    rng, squares = np.random.default_rng(31), []
    for _ in range(400):
        truth, found = frame(rng)
        attitude = find_attitude(found, method, calibrated=True)
        squares.append(error(attitude, truth)**2 / np.diag(attitude.covariance_rad2))
    low, high = chi2.ppf([0.0005, 0.9995], 400) / 400
    assert (np.mean(squares, 0) > low).all() and (np.mean(squares, 0) < high).all()


def test_errors_larger_than_stated_widen_the_covariance():
    rng, ratio = np.random.default_rng(32), []
    for _ in range(100):
        truth, found = frame(rng, worse=4.0, sd_px=(0.1, 0.1))
        attitude = find_attitude(found, "quest", calibrated=True)
        ratio.append(error(attitude, truth)**2 / np.diag(attitude.covariance_rad2))
    assert 0.6 < np.mean(ratio) < 1.5


def test_outliers_are_left_out_and_good_stars_kept():
    rng, kept = np.random.default_rng(33), []
    for _ in range(100):
        truth, found = frame(rng, sd_px=(0.1, 0.1))
        xy = found.xy_px.copy()
        xy[[3, 8]] += [[1.5, 0], [-2, 2]]
        found = Identification(**{**vars(found), "xy_px": xy})
        rest, attitude = attitude_without_outliers(found, "quest", calibrated=True)
        assert not {3, 8} & set(rest.spot_rows.tolist())
        assert len(rest.spot_rows) == len(attitude.residual_px)
        assert np.linalg.norm(error(attitude, truth)[:2]) * 1416.7 < 0.15
        kept.append(len(rest.spot_rows))
    assert np.mean(kept) > 17.9  # of 18 good ones


def test_stars_on_one_spot_are_no_attitude():
    truth, found = frame(np.random.default_rng(34), 4)
    together = Identification(**{**vars(found), "xy_px": np.repeat(found.xy_px[:1], 4, 0),
                                 "direction_icrs": np.repeat(found.direction_icrs[:1], 4, 0)})
    _, attitude = attitude_without_outliers(together, "quest", calibrated=True)
    assert attitude.status == "rejected" and "parallel" in attitude.reason
    near = found.xy_px[0] + np.array([[0, 0], [0.3, 0], [0, 0.3], [0.3, 0.3]])
    close = Identification(**{**vars(found), "xy_px": near, "direction_icrs": projection.unproject(LENS, near) @ truth})
    _, attitude = attitude_without_outliers(close, "quest", calibrated=True)
    assert attitude.status == "rejected" and "too close" in attitude.reason
