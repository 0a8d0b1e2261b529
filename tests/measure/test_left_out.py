"""Views left out without adjusting again, against adjusting again."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.geometry import projection
from calibench.geometry.projection_error import direction_covariance
from calibench.geometry.rotation import nearest_rotation
from calibench.measure._bundle import covariance
from calibench.measure._bundle.adjust import adjust
from calibench.measure._bundle.left_out import effect_sd, left_out
from calibench.measure._bundle.start import start
from calibench.records import Intrinsics

SIZE = (640, 480)
TRUTH = Intrinsics(model="brown4", fx_px=530.0, fy_px=532.0, cx_px=322.0, cy_px=236.0, image_size_px=SIZE,
                   distortion=[-0.28, 0.08, 1e-3, -5e-4], covariance=np.zeros((8, 8)))


@pytest.fixture(scope="module")
def solved(board_corners):
    """A solution of which view 4 errs as a whole: it is what a sensitive measure has to find."""
    rng = np.random.default_rng(11)
    points, corners = board_corners(TRUTH, rng, views=12, sigma_px=0.1, bow_mm=(0.1, 0.0))
    corners[4] += 0.4 * np.sin(points[:, :2] / 30)
    lens, boards = start(corners, points, SIZE, "brown4")
    return adjust(lens, [dataclasses.replace(boards, bow_free=True)])


def refitted(solved, view):
    """The lens without a view, adjusted again; and that view's residuals under it, its pose fitted."""
    (boards,) = solved.blocks
    rest = adjust(solved.intrinsics, [boards.take(np.arange(12) != view)])
    alone = dataclasses.replace(boards.take(np.arange(12) == view), bow_mm=rest.blocks[0].bow_mm)
    return rest, adjust(rest.intrinsics, [alone], lens_fixed=True).residual_px[0]


def test_held_out_error_and_step_are_those_of_adjusting_again(solved):
    left = left_out(solved)
    sd = np.sqrt(np.diag(covariance.classical(solved)))
    square = []
    for view in range(12):
        rest, residual = refitted(solved, view)
        moved = np.append(rest.intrinsics.parameters, rest.blocks[0].bow_mm) - np.append(
            solved.intrinsics.parameters, solved.blocks[0].bow_mm)
        np.testing.assert_allclose(left.step[view] / sd, moved / sd, atol=0.05 + 0.03 * np.abs(moved / sd).max())
        square.append(np.mean(np.sum(residual**2, axis=-1)))
        assert left.square_px2[view] == pytest.approx(square[-1], rel=0.01)
    assert left.rms_px == pytest.approx(np.sqrt(np.mean(square)), rel=2e-3)
    training = np.sqrt(np.mean(np.sum(solved.residual_px**2, axis=-1)))
    assert left.rms_px > 1.001 * training


@pytest.mark.parametrize("view", [4, 5, 9])
def test_the_effect_is_the_move_of_the_corners(solved, view):
    lens = dataclasses.replace(solved.intrinsics, covariance=covariance.classical(solved)[:8, :8])
    effect = effect_sd(left_out(solved), lens)
    grid = np.array([[0, 0], [639, 0], [0, 479], [639, 479.0]])
    rest, _ = refitted(solved, view)
    before, after = (projection.unproject(i, grid) for i in (lens, rest.intrinsics))
    moved = np.linalg.norm(after @ nearest_rotation(before.T @ after).T - before, axis=1)
    sd = np.sqrt(np.trace(direction_covariance(lens, grid), axis1=1, axis2=2))
    assert effect[view] == pytest.approx((moved / sd).max(), rel=0.06)


def test_a_view_that_alone_determines_a_parameter_is_said(solved):
    lonely = solved.information.copy()
    lonely[1:, 0], lonely[1:, :, 0] = 0, 0
    left = left_out(dataclasses.replace(solved, information=lonely))
    assert not np.isfinite(left.square_px2[0]) and np.isfinite(left.square_px2[1:]).all()
