"""The adjustment: start values, OpenCV's optimum, bow, partial boards, blocks of two kinds in one problem."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.geometry import projection
from calibench.geometry.rotation import matrix_from_rotvec
from calibench.measure import _board_lens as board_lens
from calibench.measure._bundle import covariance
from calibench.measure._bundle.adjust import COARSE, adjust
from calibench.measure._bundle.block import linearised
from calibench.measure._bundle.boards import bow_shape
from calibench.measure._bundle.outliers import Rejection, without_outliers
from calibench.measure._bundle.star_frames import StarFrames
from calibench.measure._bundle.start import posed, start
from calibench.records import Identification, Intrinsics

SIZE = (640, 480)
TRUTH = Intrinsics(model="brown4", fx_px=530.0, fy_px=532.0, cx_px=322.0, cy_px=236.0, image_size_px=SIZE,
                   distortion=[-0.28, 0.08, 1e-3, -5e-4], covariance=np.zeros((8, 8)))


def solved(corners, points, *, bow_free=False, model="brown4"):
    lens, boards = start(corners, points, SIZE, model)
    return adjust(lens, [dataclasses.replace(boards, bow_free=bow_free)])


def star_frames(rng, *, frames=6, stars=30, sigma_px=0.1):
    """Identifications of random stars seen through TRUTH."""
    out = []
    for _ in range(frames):
        turn = matrix_from_rotvec(rng.normal(0, 1, 3))
        xy = rng.uniform((5, 5), np.array(SIZE) - 6, (stars, 2))
        out.append(Identification(
            status="solved", method="test", spot_rows=np.arange(stars), star_rows=np.arange(stars),
            xy_px=xy + rng.normal(0, sigma_px, xy.shape), covariance_px2=np.tile(np.eye(2) * sigma_px**2, (stars, 1, 1)),
            direction_icrs=projection.unproject(TRUTH, xy) @ turn, intrinsics=TRUTH))
    return out


def test_start_values_are_near_for_a_lens_without_distortion(board_corners):
    ideal = dataclasses.replace(TRUTH, distortion=np.zeros(4), cx_px=319.5, cy_px=239.5)
    points, corners = board_corners(ideal, np.random.default_rng(0), sigma_px=0)
    lens, boards = start(corners, points, SIZE, "brown4")
    assert lens.fx_px == pytest.approx(530, rel=1e-6) and lens.fy_px == pytest.approx(532, rel=1e-6)
    seen = projection.project(ideal, boards.to_camera().reshape(3, -1).T)
    np.testing.assert_allclose(seen, corners.reshape(-1, 2), atol=1e-6)


def test_start_refuses_views_without_tilt():
    points = np.array([[x, y, 0.0] for y in range(5) for x in range(7)]) * 25
    flat = [points[:, :2] * scale + (120, 150) for scale in (1.0, 1.2, 1.4)]
    with pytest.raises(BadInput, match="focal length"):
        start(np.array(flat), points, SIZE, "brown4")


@pytest.mark.parametrize("model", ["brown4", "brown5", "rational8"])
def test_optimum_is_that_of_opencv(board_corners, model):
    points, corners = board_corners(TRUTH, np.random.default_rng(1), views=20)
    mine = solved(corners, points, model=model)
    flags = {"brown4": cv2.CALIB_FIX_K3, "brown5": 0, "rational8": cv2.CALIB_RATIONAL_MODEL}[model]
    terms = np.append(mine.intrinsics.distortion, np.zeros(4))[:8]
    rms, camera, *_ = cv2.calibrateCamera(
        [points.astype(np.float32)] * len(corners), [c.astype(np.float32) for c in corners], SIZE,
        mine.intrinsics.camera_matrix, terms, flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 300, 1e-14))
    assert np.sqrt(np.mean(np.sum(mine.residual_px**2, -1))) == pytest.approx(rms, abs=1e-5)
    assert mine.intrinsics.fx_px == pytest.approx(camera[0, 0], abs=0.02)


@pytest.mark.parametrize(("model", "terms"), [("fisheye4", [0.05, -0.01, 0.003, -0.001]),
                                              ("thin_prism12", [-0.28, 0.08, 1e-3, -5e-4, *[0] * 4, 2e-3, -1e-3, 1e-3, 1e-3])])
def test_other_lenses_are_found_from_noisy_corners(board_corners, model, terms):
    focal = 200.0 if model == "fisheye4" else 530.0
    truth = Intrinsics(model=model, fx_px=focal, fy_px=focal + 1, cx_px=322.0, cy_px=236.0, image_size_px=SIZE,
                       distortion=terms, covariance=np.zeros((4 + len(terms),) * 2))
    points, corners = board_corners(truth, np.random.default_rng(10), views=25, sigma_px=0.05)
    solution, kept = board_lens.solve(corners, points, SIZE, model, rejection=Rejection(sigma=4, most=0.03), worst_view=4)
    assert kept.all() and not solution.folds
    sd = np.sqrt(np.diag(covariance.classical(solution)))[:4]
    assert (np.abs(solution.intrinsics.parameters - truth.parameters)[:4] < 4 * sd).all()
    assert np.sqrt(np.mean(solution.residual_px**2)) == pytest.approx(0.05, abs=0.003)


@pytest.mark.parametrize("kind", ["boards", "stars"])
def test_rows_are_the_derivatives(board_corners, kind):
    rng = np.random.default_rng(2)
    if kind == "boards":
        points, corners = board_corners(TRUTH, rng, views=3, sigma_px=1)
        block = posed(TRUTH, corners, points, bow_free=True, bow_mm=np.array([0.3, -0.2]))
    else:
        block = StarFrames.of(TRUTH, star_frames(rng, frames=3, sigma_px=1))
    gram, cost, residual = linearised(block, TRUTH, lens_free=True)
    lens_count, own = 8, block.own_count

    def cost_at(step, view):
        p = TRUTH.parameters + step[:lens_count]
        lens = dataclasses.replace(TRUTH, fx_px=p[0], fy_px=p[1], cx_px=p[2], cy_px=p[3], distortion=p[4:])
        poses = np.zeros((len(block.weight), block.pose_count))
        poses[view] = step[lens_count + own:]
        moved = block.moved(step[lens_count:lens_count + own], poses)
        return np.sum((linearised(moved, lens, lens_free=True)[2][view] * block.weight[view]) ** 2)

    for view in range(3):
        for i, gradient in enumerate(-2 * gram[view, :, -1]):
            h = 1e-6 if i >= 4 else 1e-4
            e = np.eye(gram.shape[1])[i] * h
            assert (cost_at(e, view) - cost_at(-e, view)) / (2 * h) == pytest.approx(gradient, rel=1e-4, abs=1e-2)
    assert cost == pytest.approx(np.sum((residual * block.weight[:, None]) ** 2))


def test_views_taken_some_at_a_time_give_the_same(board_corners, monkeypatch):
    points, corners = board_corners(TRUTH, np.random.default_rng(3), views=11)
    whole = solved(corners, points, bow_free=True)
    monkeypatch.setattr("calibench.measure._bundle.block.POINTS_AT_A_TIME", 200)
    parts = solved(corners, points, bow_free=True)
    np.testing.assert_allclose(parts.intrinsics.parameters, whole.intrinsics.parameters, rtol=1e-9)
    assert len(parts.information) == 11


def test_bow_is_recovered_and_its_neglect_biases_the_focal_length(board_corners):
    points, corners = board_corners(TRUTH, np.random.default_rng(4), views=30, sigma_px=0.02, bow_mm=(0.2, -0.1))
    bent, flat = solved(corners, points, bow_free=True), solved(corners, points)
    np.testing.assert_allclose(bent.blocks[0].bow_mm, (0.2, -0.1), atol=0.01)
    assert abs(bent.intrinsics.fx_px - 530) < 0.15 < abs(flat.intrinsics.fx_px - 530)


def test_corners_that_were_not_found_do_not_count(board_corners):
    points, corners = board_corners(TRUTH, np.random.default_rng(5), views=12, sigma_px=0)
    corners[3, :20] = np.nan
    corners[5, 30:] = np.nan
    solution = solved(corners, points)
    assert solution.intrinsics.fx_px == pytest.approx(530, abs=1e-5)
    assert solution.degrees_of_freedom == 2 * (12 * 54 - 44) - 12 * 6 - 8


def test_outliers_are_set_aside_and_counted_once(board_corners):
    points, corners = board_corners(TRUTH, np.random.default_rng(6), views=12)
    corners[2, 7] += 5
    corners[5, 40] -= 3
    lens, boards = start(corners, points, SIZE, "brown4")
    solution = without_outliers(adjust(lens, [boards], tolerance=COARSE), Rejection(sigma=4, most=0.03))
    weight = solution.blocks[0].weight
    assert weight[2, 7] == weight[5, 40] == 0 and np.mean(weight == 0) < 0.01
    assert np.hypot(*solution.residual_px[2, 7]) == pytest.approx(5 * np.sqrt(2), abs=0.5)


def test_error_bar_sees_errors_that_a_view_shares(board_corners):
    rng = np.random.default_rng(7)
    points, clean = board_corners(TRUTH, rng, views=20, sigma_px=0)
    common = bow_shape(points)
    values, classical, clustered = [], [], []
    for _ in range(60):  # each view sees its own smooth deformation, as motion blur or a warped print under stress gives
        smooth = np.einsum("vbi,pb->vpi", rng.normal(0, 0.3, (20, 2, 2)), common)
        solution = solved(clean + smooth + rng.normal(0, 0.05, clean.shape), points, bow_free=True)
        values.append(solution.intrinsics.fx_px)
        classical.append(covariance.classical(solution)[0, 0])
        clustered.append(covariance.clustered(solution)[0, 0])
    scatter = np.std(values)
    assert np.sqrt(np.mean(classical)) < 0.6 * scatter
    assert np.sqrt(np.mean(clustered)) == pytest.approx(scatter, rel=0.3)


def test_poses_only_leaves_the_lens(board_corners):
    points, corners = board_corners(TRUTH, np.random.default_rng(8), views=5, sigma_px=0)
    boards = posed(TRUTH, corners, points, bow_free=True)
    shaken = boards.moved(np.zeros(2), np.random.default_rng(8).normal(0, 0.01, (5, 6)))
    solution = adjust(TRUTH, [shaken], lens_fixed=True)
    assert (solution.intrinsics.parameters == TRUTH.parameters).all() and (solution.blocks[0].bow_mm == 0).all()
    assert solution.information.shape == (5, 0, 0) and np.abs(solution.residual_px).max() < 1e-6


def test_boards_and_stars_stand_in_one_problem(board_corners):
    rng = np.random.default_rng(9)
    points, corners = board_corners(TRUTH, rng, views=10, sigma_px=0.1, bow_mm=(0.1, 0.0))
    lens, boards = start(corners, points, SIZE, "brown4")
    boards = dataclasses.replace(boards.weighted(boards.weight / 0.1), bow_free=True)
    first = adjust(lens, [boards])
    stars = StarFrames.of(first.intrinsics, star_frames(rng))
    both = adjust(first.intrinsics, [*first.blocks, stars])
    assert both.information.shape == (16, 10, 10)
    assert not both.information[10:, 8:].any()  # stars know nothing of the board's bow
    alone, together = (np.sqrt(np.diag(covariance.classical(s))) for s in (first, both))
    assert (together[:4] < 0.6 * alone[:4]).all()
    assert (np.abs(both.intrinsics.parameters - TRUTH.parameters) < 4 * together[:8]).all()
