"""Intrinsics: truth from projected corners, an honest error bar, and what real views and wrong boards give."""

from __future__ import annotations

import functools

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.geometry.rotation import matrix_from_rotvec
from calibench.measure import intrinsics
from calibench.records import Frame, Intrinsics

SIZE = (640, 480)
BOARD, SQUARE_MM = (9, 6), 25.0
TRUTH = Intrinsics(model="brown4", fx_px=530.0, fy_px=532.0, cx_px=322.0, cy_px=236.0, image_size_px=SIZE,
                   distortion=[-0.28, 0.08, 1e-3, -5e-4], covariance=np.zeros((8, 8)))


@functools.cache
def rays():
    """Directions (N, 3) of 2 x 2 samples in each pixel of TRUTH."""
    x, y = np.meshgrid((np.arange(SIZE[0] * 2) - 0.5) / 2, (np.arange(SIZE[1] * 2) - 0.5) / 2)
    pixels, terms = np.stack([x.ravel(), y.ravel()], -1), np.append(TRUTH.distortion, 0)
    plane = cv2.undistortPoints(pixels[:, None], TRUTH.camera_matrix, terms)
    return np.column_stack([plane[:, 0], np.ones(x.size)])


def board_image(rotvec, place_mm, *, squares=(10, 7)):
    """A rendered view (H, W) uint8 through TRUTH."""
    turn = matrix_from_rotvec(np.array(rotvec, float))
    to_plane = np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], place_mm]))
    on_board = rays() @ to_plane.T
    column, row = (on_board[:, :2] / on_board[:, 2:]).T / SQUARE_MM + np.array(squares)[:, None] / 2
    inside = (column >= 0) & (column < squares[0]) & (row >= 0) & (row < squares[1])
    dark = inside & ((np.floor(column) + np.floor(row)) % 2 == 0)
    light = np.where(dark, 30.0, 220.0).reshape(SIZE[1], 2, SIZE[0], 2).mean(axis=(1, 3))
    return np.rint(light).astype(np.uint8)


def views_of_board(count=8):
    rng = np.random.default_rng(5)
    poses = [(np.append(rng.uniform(-0.45, 0.45, 2), rng.uniform(-0.2, 0.2)),
              (rng.uniform(-30, 30), rng.uniform(-20, 20), rng.uniform(380, 450))) for _ in range(count)]
    return [frame(board_image(*pose), f"view{i}.png") for i, pose in enumerate(poses)]


def frame(data, file=""):
    return Frame(data=data, kind="light", bit_depth=8, white_level_dn=255, file=file)


@pytest.fixture(scope="module")
def rendered():
    return views_of_board()


def test_wild_corners_and_a_wild_view_are_left_out(board_corners):
    rng = np.random.default_rng(4)
    points, corners = board_corners(TRUTH, rng, views=12)
    corners[2, 7] += 5
    corners[5, 40] -= 3
    corners[9] += rng.normal(0, 6, corners[9].shape)
    solution, inlier, kept = intrinsics._robust(corners, points, SIZE, "brown4", intrinsics.Settings())
    assert not kept[9] and kept.sum() == 11
    assert not inlier[2, 7] and not inlier[5, 40] and inlier.mean() > 0.97
    assert solution.intrinsics.fx_px == pytest.approx(530, abs=2)


def test_rendered_views_give_the_camera_back(rendered):
    result = intrinsics.measure(rendered, intrinsics.Settings(board=BOARD, square_mm=SQUARE_MM))
    sd = np.sqrt(np.diag(result.intrinsics.covariance))
    assert result.intrinsics.model == "brown4"
    assert abs(result.intrinsics.fx_px - 530) < max(4 * sd[0], 0.5)
    assert abs(result.intrinsics.cx_px - 322) < max(4 * sd[2], 0.5)
    assert result.quantity("rms_px").value < 0.1
    assert result.frames_used == 8 and len(result.evidence["corners_xy_px"]) == 8 * 54
    assert set(result.provenance.inputs) == {f"view{i}.png" for i in range(8)}


@pytest.mark.parametrize("said", [(8, 6), (10, 7), (9, 7)])
def test_another_board_size_is_named(rendered, said):
    with pytest.raises(BadInput, match=f"found 9x6, you said {said[0]}x{said[1]}: count inner corners"):
        intrinsics.measure(rendered[:3], intrinsics.Settings(board=said))


def test_duplicates_and_frames_without_a_board_are_rejected_with_a_reason(rendered):
    empty = frame(np.full((480, 640), 90, np.uint8), "wall.png")
    again = frame(rendered[0].data, "copy.png")
    result = intrinsics.measure([*rendered, empty, again])
    assert result.frames_used == 8
    reasons = dict(result.frames_rejected)
    assert "9x6" in reasons["wall.png"] and "view0.png" in reasons["copy.png"]


def test_views_without_tilt_do_not_give_a_focal_length():
    rng = np.random.default_rng(6)
    flat = [frame(board_image((0, 0, 0), (rng.uniform(-30, 30), rng.uniform(-20, 20), 400)), f"{i}.png") for i in range(5)]
    with pytest.raises(BadInput, match="focal length"):
        intrinsics.measure(flat)


def test_two_views_are_too_few(rendered):
    with pytest.raises(BadInput, match="3 are the least"):
        intrinsics.measure(rendered[:2])


def test_real_boards(real):
    files = sorted((real / "boards" / "opencv").glob("*.jpg"))
    frames = [Frame(data=cv2.imread(str(f), cv2.IMREAD_GRAYSCALE), bit_depth=8, white_level_dn=255, file=f.name) for f in files]
    result = intrinsics.measure(frames)
    assert result.frames_used == 13 and result.intrinsics.model == "brown4"
    assert result.quantity("rms_px").value <= 0.20
    assert 532.3 < result.intrinsics.fx_px < 534.5
    assert -0.19 < result.quantity("board_bow_y_mm").value < -0.15
    classical = result.evidence["uncertainty_classical"]
    assert result.quantity("fx_px").uncertainty > 1.3 * classical[0]


@pytest.mark.parametrize("stretch", [(6.0, 0.4), (1.28, 1.0), (1.6, 0.8), (0.25, 1.6)])
def test_a_view_of_another_camera_spoils_no_other(board_corners, stretch):
    rng = np.random.default_rng(8)
    points, corners = board_corners(TRUTH, rng, views=9)
    corners[6] = corners[6] * stretch + 100
    solution, _, kept = intrinsics._robust(corners, points, SIZE, "brown4", intrinsics.Settings())
    assert not kept[6] and kept.sum() >= 7
    assert solution.intrinsics.fx_px == pytest.approx(530, abs=3)
