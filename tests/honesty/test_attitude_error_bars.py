"""Error bars of an attitude: the random part with a true lens, the systematic part over independently calibrated lenses.

The bounds are those of samples of this size; `make bench` asks for 2000 frames and 200 lenses.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from calibench.geometry import projection
from calibench.io.star_table import load_star_table
from calibench.measure import _board_lens as board_lens
from calibench.measure._bundle import covariance
from calibench.measure._bundle.outliers import Rejection
from calibench.records import Identification, Intrinsics, Observer
from calibench.stars.frame_attitude import attitude_without_outliers, find_attitude, spot_weights
from calibench.stars.lens_error import systematic
from calibench.stars.sky_catalogue import SkyCatalogue

SIZE = (752, 480)
TRUTH = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=379.0, cy_px=236.0, distortion=[-0.37, 0.31, -1e-3, 3e-4],
                   image_size_px=SIZE, covariance=np.zeros((8, 8)))


def look(sky, rng, lens, *, noisy=True):
    """A random attitude and the stars that the true lens shows there, with photon noise; identified through `lens`."""
    while True:
        truth = Rotation.random(random_state=rng).as_matrix()
        xy = projection.project(TRUTH, sky.directions @ truth.T)
        rows = np.flatnonzero(((xy > 4) & (xy < np.subtract(SIZE, 5))).all(1))
        if len(rows) >= 6:
            break
    sd = 0.02 * 10 ** (0.2 * (sky.magnitude[rows] - 3))
    noise = rng.normal(size=(len(rows), 2)) * sd[:, None] * noisy
    return truth, Identification(
        status="solved", method="", spot_rows=np.arange(len(rows)), star_rows=rows, xy_px=xy[rows] + noise,
        covariance_px2=sd[:, None, None] ** 2 * np.eye(2), direction_icrs=sky.directions[rows], intrinsics=lens)


def error(attitude, truth):
    """Rotation vector d, rad, in camera axes, with R_true = exp(d) R."""
    return Rotation.from_matrix(truth @ Rotation.from_quat(attitude.q_cam_icrs).as_matrix().T).as_rotvec()


def sky_to(faintest):
    table = load_star_table()
    return SkyCatalogue.seen_by(table.take(table.hp_mag <= faintest), Observer())


def random_squares(frames, seed):
    """Normalised error squared (frames, 3) with the true lens."""
    sky, rng, out = sky_to(6.0), np.random.default_rng(seed), []
    for _ in range(frames):
        truth, found = look(sky, rng, TRUTH)
        _, attitude = attitude_without_outliers(found, "quest", calibrated=True)
        out.append(error(attitude, truth) ** 2 / np.diag(attitude.covariance_rad2))
    return np.array(out)


def systematic_squares(board_corners, maps, seed, *, noise_px=0.1):
    """Normalised squares over independently calibrated lenses: of the bias alone (maps, 3), and of bias and noise together."""
    rng, sky = np.random.default_rng(seed), sky_to(5.5)
    points, clean = board_corners(TRUTH, rng, views=15, sigma_px=0)
    biases, totals = [], []
    for _ in range(maps):
        solution, _ = board_lens.solve(clean + rng.normal(0, noise_px, clean.shape), points, SIZE, "brown4",
                                       rejection=Rejection(sigma=4, most=0.03), worst_view=4)
        lens = dataclasses.replace(solution.intrinsics, covariance=covariance.recommended(solution)[:8, :8])
        truth, found = look(sky, rng, lens, noisy=False)
        attitude = find_attitude(found, "quest", calibrated=True)
        said, _ = systematic(found, Rotation.from_quat(attitude.q_cam_icrs).as_matrix(), spot_weights(found, calibrated=True))
        biases.append(error(attitude, truth) ** 2 / np.diag(said))
        truth, found = look(sky, rng, lens)
        attitude = find_attitude(found, "quest", calibrated=True)
        said, _ = systematic(found, Rotation.from_quat(attitude.q_cam_icrs).as_matrix(), spot_weights(found, calibrated=True))
        totals.append(error(attitude, truth) ** 2 / np.diag(said + attitude.covariance_rad2))
    return np.array(biases), np.array(totals)


def test_random_part_with_the_true_lens():
    squares = random_squares(400, 91)
    np.testing.assert_allclose(squares.mean(0), 1, atol=0.25)  # 3.5 standard errors of 400


def test_systematic_part_over_calibrated_lenses(board_corners):
    biases, totals = systematic_squares(board_corners, 60, 92)
    np.testing.assert_allclose(biases.mean(0), 1, atol=0.65)  # 3.5 standard errors of 60
    np.testing.assert_allclose(totals.mean(0), 1, atol=0.65)
