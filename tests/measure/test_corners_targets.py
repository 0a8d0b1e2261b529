"""ChArUco boards and grids of dots, rendered through a pinhole camera: places, parts, identity, mirrors, sizes."""

from __future__ import annotations

import functools

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.geometry.rotation import matrix_from_rotvec
from calibench.measure import intrinsics
from calibench.measure.corners import _views as views
from calibench.measure.corners import charuco, circles, circles_asymmetric
from calibench.measure.corners._target import Target
from calibench.records import Frame

SIZE = (640, 480)
CAMERA = np.array([[600.0, 0, 322.0], [0, 601.0, 236.0], [0, 0, 1]])
DOTS_PX = 60  # of the print, for one square
OVER = 4  # rays a pixel and axis
CHARUCO = Target(board=(7, 5), square_mm=25.0, marker_mm=18.0, dictionary="4X4_50")
DOTS = Target(board=(7, 6), square_mm=25.0)
SHIFTED = Target(board=(4, 11), square_mm=25.0)
TILTED = (0.5, -0.35, 0.2)
PLACE_MM = (10.0, -5.0, 330.0)


@functools.cache
def printed(kind):
    """The print (rows, columns) uint8, DOTS_PX a square, two squares of margin; and where its first point lies, squares."""
    if kind == "charuco":
        board = cv2.aruco.CharucoBoard((8, 6), 25.0, 18.0, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
        squares = board.generateImage((8 * DOTS_PX, 6 * DOTS_PX), marginSize=0)
        return np.pad(squares, 2 * DOTS_PX, constant_values=255), 3.0
    at = circles.points(DOTS.board) if kind == "circles" else circles_asymmetric.points(SHIFTED.board)
    size = (np.ptp(at, axis=0) + 4).astype(int) * DOTS_PX
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    paper = np.full((size[1], size[0]), 255, np.uint8)
    for u, v in (at + 2) * DOTS_PX:
        paper[np.hypot(x - u, y - v) < (0.3 if kind == "circles" else 0.4) * DOTS_PX] = 0
    return paper, 2.0


def seen(kind, target, *, rotvec=TILTED, place_mm=PLACE_MM, blur_px=0.7, noise_dn=1.0, seed=0):
    """A view (H, W) uint8 and its true points (P, 2)."""
    paper, first = printed(kind)
    module = {"charuco": charuco, "circles": circles, "circles_asymmetric": circles_asymmetric}[kind]
    at_mm = views.points_mm(target, module)
    middle = np.append((at_mm[:, :2].max(axis=0)) / 2, 0)
    turn = matrix_from_rotvec(np.array(rotvec))
    v_cam = (at_mm - middle) @ turn.T + place_mm
    truth = (v_cam / v_cam[:, 2:]) @ CAMERA.T
    to_image = CAMERA @ np.column_stack([turn[:, :2], turn @ -middle + place_mm])  # from mm on the board
    to_print = np.array([[DOTS_PX / 25, 0, first * DOTS_PX - 0.5], [0, DOTS_PX / 25, first * DOTS_PX - 0.5], [0, 0, 1]])
    finer = np.array([[OVER, 0, (OVER - 1) / 2], [0, OVER, (OVER - 1) / 2], [0, 0, 1]])
    large = cv2.warpPerspective(paper.astype(np.float32), finer @ to_image @ np.linalg.inv(to_print),
                                (SIZE[0] * OVER, SIZE[1] * OVER), borderValue=255)
    light = large.reshape(SIZE[1], OVER, SIZE[0], OVER).mean(axis=(1, 3))
    light = 20 + 0.8 * cv2.GaussianBlur(light, (0, 0), blur_px)
    return np.rint(light + np.random.default_rng(seed).normal(0, noise_dn, light.shape)).astype(np.uint8), truth[:, :2]


def looked_at(image, kind, target):
    return views.look(image, image, target, views.detectors(kind, None), 0.2)["symmetry"]


def rms(error):
    return float(np.sqrt(np.nanmean(np.sum(error**2, axis=-1))))


@pytest.mark.parametrize(("kind", "target"), [("charuco", CHARUCO), ("circles", DOTS)])
def test_points_are_found_to_a_hundredth_of_a_pixel(kind, target):
    image, truth = seen(kind, target)
    assert rms(looked_at(image, kind, target).xy_px - truth) < 0.02


def test_asymmetric_dots_either_way_up():
    image, truth = seen("circles_asymmetric", SHIFTED, place_mm=(0.0, 0.0, 420.0))
    for turned in (0.0, np.pi / 2, np.pi):
        image, truth = seen("circles_asymmetric", SHIFTED, rotvec=(0.3, 0.0, turned), place_mm=(0.0, 0.0, 430.0))
        assert rms(looked_at(image, "circles_asymmetric", SHIFTED).xy_px - truth) < 0.02


def test_the_image_of_a_dot_s_middle_is_found_and_not_the_middle_of_its_image():
    image, truth = seen("circles", DOTS, rotvec=(0.9, 0.0, 0.0), place_mm=(0.0, 0.0, 300.0), noise_dn=0.3)
    rough = circles.find(image, DOTS)
    assert np.abs((rough - truth)[:, 1].mean()) > 0.1  # OpenCV's
    assert np.abs((looked_at(image, "circles", DOTS).xy_px - truth)[:, 1].mean()) < 0.02


def test_a_part_of_a_charuco_board_keeps_its_identity():
    image, truth = seen("charuco", CHARUCO, place_mm=(90.0, 40.0, 300.0))
    xy = looked_at(image, "charuco", CHARUCO).xy_px
    there = np.isfinite(xy[:, 0])
    assert 9 <= there.sum() < len(truth)
    assert rms(xy - truth) < 0.03
    outside = (truth < 0).any(axis=1) | (truth > np.array(SIZE) - 1).any(axis=1)
    assert outside.any() and not there[outside].any()


def test_the_covariance_of_dots_is_honest():
    squares = []
    for seed in range(6):
        image, truth = seen("circles", DOTS, noise_dn=5.0, seed=seed)
        points = looked_at(image, "circles", DOTS)
        error = points.xy_px - truth
        squares.append(np.einsum("pi,pij,pj->p", error, np.linalg.inv(points.covariance_px2), error) / 2)
    assert 0.4 < np.mean(squares) < 1.5  # cautious where the window is seen in larger pixels


def test_a_mirrored_image_is_said_where_the_target_shows_it():
    image, _ = seen("charuco", CHARUCO)
    with pytest.raises(BadInput, match="mirrored"):
        looked_at(np.ascontiguousarray(image[:, ::-1]), "charuco", CHARUCO)
    blank = np.full_like(image, 128)
    assert views.look(blank, blank, CHARUCO, [charuco], 0.2) is None


@pytest.mark.parametrize(("change", "what"), [
    ({"dictionary": "7X7_9"}, "no marker dictionary"),
    ({"marker_mm": 30.0}, "do not fit"),
    ({"board": (20, 20)}, "carry 220 markers"),
])
def test_an_impossible_charuco_board_is_refused(change, what):
    image, _ = seen("charuco", CHARUCO)
    board = {"board": CHARUCO.board, "square_mm": 25.0, "marker_mm": 18.0, "dictionary": "4X4_50"} | change
    with pytest.raises(BadInput, match=what):
        looked_at(image, "charuco", Target(**board))


def poses(count, rng):
    for i in range(count):
        tilt = np.array([np.cos(i * 2.4), np.sin(i * 2.4)]) * rng.uniform(0.35, 0.6)
        yield (*tilt, rng.uniform(-0.2, 0.2)), (rng.uniform(-40, 40), rng.uniform(-25, 25), rng.uniform(300, 360))


@pytest.mark.parametrize(("kind", "target"), [("charuco", CHARUCO), ("circles", DOTS)])
def test_the_camera_comes_back_from_views_of(kind, target):
    rng = np.random.default_rng(7)
    frames = [Frame(data=seen(kind, target, rotvec=r, place_mm=p, seed=i)[0], kind="light", bit_depth=8, white_level_dn=255,
                    file=f"{i}.png") for i, (r, p) in enumerate(poses(10, rng))]
    result = intrinsics.measure(frames, intrinsics.Settings(board=target.board, target=kind, marker_mm=target.marker_mm))
    assert result.frames_used >= 8
    found = np.array([result.quantity(name).value for name in ("fx_px", "fy_px", "cx_px", "cy_px")])
    assert (np.abs(found - [600, 601, 322, 236]) < 0.5).all()
    assert result.quantity("rms_px").value < 0.03
    evidence = result.evidence
    assert evidence["corners_covariance_px2"].shape == (len(evidence["corners_xy_px"]), 2, 2)
    assert (np.linalg.eigvalsh(evidence["corners_covariance_px2"]) > 0).all()


def test_another_number_of_dots_is_named():
    frames = [Frame(data=seen("circles", DOTS, rotvec=r, place_mm=p)[0], kind="light", bit_depth=8, white_level_dn=255)
              for r, p in poses(3, np.random.default_rng(8))]
    with pytest.raises(BadInput, match="found 7x6, you said 7x5: count dots"):
        intrinsics.measure(frames, intrinsics.Settings(board=(7, 5), target="circles"))
