"""Corners against rendered truth: sub-pixel places, their covariance, blur, windows, and the size of the board."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput, UsageError
from calibench.measure.corners import _views as views
from calibench.measure.corners import checkerboard, checkerboard_parts, checkerboard_sectors
from calibench.measure.corners._symmetry import refine, roughness_px
from calibench.measure.corners._target import Target, grid
from calibench.records import Frame
from calibench.simulate.board import Board, BoardPose, corner_pixels, render_board
from calibench.simulate.camera import thesis_camera

BOARD = (9, 6)
TARGET = Target(board=BOARD)
UV = grid(BOARD)
POSES = (BoardPose(rotvec_rad=(0.35, -0.3, 0.1), translation_mm=(-110.0, -65.0, 720.0)),
         BoardPose(rotvec_rad=(-0.45, 0.1, -0.2), translation_mm=(-85.0, -45.0, 640.0)),
         BoardPose(rotvec_rad=(0.1, 0.6, 0.3), translation_mm=(-60.0, -70.0, 800.0)))


@functools.cache
def view(pose=0, blur_px=0.7):
    """Image (H, W) with white at 200 of 255 and true corners (P, 2); the lens of the thesis, distortion included."""
    camera, board = thesis_camera(), Board(columns=BOARD[0], rows=BOARD[1], square_mm=25.0)
    light = render_board(camera, board, POSES[pose], white_e=1.0, blur_sigma_px=blur_px) / camera.transmission
    return 200 * light, corner_pixels(camera, board, POSES[pose])


def started(truth, seed=0, by_px=0.7):
    return truth + np.random.default_rng(seed).uniform(-by_px, by_px, truth.shape)


def rms(error):
    return float(np.sqrt(np.mean(np.sum(error**2, axis=-1))))


@pytest.mark.parametrize("window", [0.1, 0.2, 0.25, 0.4])
@pytest.mark.parametrize("pose", range(len(POSES)))
def test_noiseless_corners_are_found_to_a_few_thousandths_of_a_pixel(pose, window):
    image, truth = view(pose)
    xy, _ = refine(image, started(truth), UV, window)
    assert rms(xy - truth) < 0.004 and np.abs(xy - truth).max() < 0.01


def test_the_camera_s_response_curve_does_not_move_corners():
    image, truth = view()
    curved = 255 * (image / 255) ** 0.45
    assert rms(refine(curved, started(truth), UV, 0.2)[0] - truth) < 0.004


@pytest.mark.parametrize("blur_px", [2.0, 5.0])
def test_blurred_corners_are_better_than_those_of_opencv(blur_px):
    image, truth = view(1)
    noisy = cv2.GaussianBlur(image, (0, 0), blur_px) + np.random.default_rng(1).normal(0, 3, image.shape)
    noisy = np.clip(noisy, 0, 255).astype(np.uint8)
    mine = rms(refine(noisy, started(truth), UV, 0.2)[0] - truth)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    gradient = cv2.cornerSubPix(noisy, started(truth).astype(np.float32), (7, 7), (-1, -1), stop)
    sector = checkerboard_sectors.find(noisy, TARGET)
    assert mine < 0.1
    assert mine < 0.7 * rms(gradient - truth)
    assert mine < 0.7 * min(rms(sector - truth), rms(sector[::-1] - truth))


@pytest.mark.parametrize(("noise_dn", "blur_px"), [(3.0, 0.7), (10.0, 0.7), (3.0, 2.0)])
def test_the_covariance_is_honest(noise_dn, blur_px):
    rng = np.random.default_rng(2)
    squares = []
    for pose in range(len(POSES)):
        image, truth = view(pose, blur_px)
        for _ in range(4):
            xy, covariance = refine(image + rng.normal(0, noise_dn, image.shape), started(truth), UV, 0.2)
            error = xy - truth
            squares.append(np.einsum("pi,pij,pj->p", error, np.linalg.inv(covariance), error) / 2)
    assert 0.85 < np.mean(squares) < 1.25  # 1 by definition, from 648 corners
    assert 0.7 < np.median(squares) / np.log(2) < 1.3


def test_the_covariance_knows_the_direction_of_blur():
    image, truth = view()
    rng = np.random.default_rng(3)
    smeared = cv2.GaussianBlur(image, (0, 0), sigmaX=4.0, sigmaY=0.3) + rng.normal(0, 2, image.shape)
    xy, covariance = refine(smeared, truth, UV, 0.2)
    predicted = np.sqrt(np.median(covariance[:, 0, 0] / covariance[:, 1, 1]))
    seen = np.std(xy[:, 0] - truth[:, 0]) / np.std(xy[:, 1] - truth[:, 1])
    assert predicted > 1.3 and seen == pytest.approx(predicted, rel=0.3)


def test_large_images_are_refined_in_larger_pixels():
    small = thesis_camera()
    lens = small.intrinsics
    size = (1880, 1200)
    lens = dataclasses.replace(lens, image_size_px=size, fx_px=2.5 * lens.fx_px, fy_px=2.5 * lens.fy_px,
                               cx_px=2.5 * lens.cx_px + 0.75, cy_px=2.5 * lens.cy_px + 0.75)
    camera, board = dataclasses.replace(small, intrinsics=lens), Board(columns=9, rows=6, square_mm=25.0)
    truth = corner_pixels(camera, board, POSES[0])
    light = render_board(camera, board, POSES[0], white_e=1.0, blur_sigma_px=0.8)  # without coma, which moves a corner
    image = 200 * light + np.random.default_rng(5).normal(0, 4, size[::-1])
    for window in (0.1, 0.3, 0.5):  # up to 3 x 3 pixels in one
        xy, covariance = refine(image, started(truth, by_px=2.0), UV, window)
        error = xy - truth
        assert rms(error) < 0.03
        squares = np.einsum("pi,pij,pj->p", error, np.linalg.inv(covariance), error) / 2
        assert 0.25 < np.mean(squares) < 1.5  # cautious: edges sharper than a (large) pixel look like noise


def test_points_not_seen_stay_so_and_those_lost_are_said():
    image, truth = view()
    rough = truth.copy()
    rough[5] = np.nan
    blank = image.copy()
    x, y = np.rint(truth[20]).astype(int)
    blank[y - 20:y + 21, x - 20:x + 21] = 90  # nothing to see there
    xy, covariance = refine(blank, rough, UV, 0.2)
    assert np.isnan(xy[[5, 20]]).all() and np.isnan(covariance[[5, 20]]).all()
    others = np.delete(np.arange(54), [5, 11, 19, 20, 21, 29])
    assert rms((xy - truth)[others]) < 0.005


def test_points_on_a_line_are_refused():
    image, truth = view()
    rough = np.full_like(truth, np.nan)
    rough[:9] = truth[:9]
    assert np.isnan(refine(image, rough, UV, 0.2)[0]).all()


def test_corners_at_the_border_of_the_image_count_with_what_is_inside():
    image, truth = view()
    left = int(truth[:, 0].min()) - 3
    xy, covariance = refine(image[:, left:], started(truth) - [left, 0], UV, 0.2)
    assert rms(xy + [left, 0] - truth) < 0.02
    assert (np.linalg.eigvalsh(covariance) > 0).all()


def test_roughness_is_the_error_that_no_lens_makes():
    _, truth = view()
    assert roughness_px(truth, UV) < 0.005
    assert roughness_px(truth + np.random.default_rng(4).normal(0, 0.1, truth.shape), UV) == pytest.approx(0.1, rel=0.25)


@pytest.mark.parametrize("window", [0.0, 0.2, 0.5, 11.0])
@pytest.mark.parametrize("detector", [checkerboard, checkerboard_sectors])
def test_any_detector_and_any_window_give_the_corners(detector, window):
    image, truth = view()
    grey, fine = views.shade(frame(np.rint(image).astype(np.uint8)))
    points = views.look(grey, fine, TARGET, [detector], window)["symmetry"]
    assert min(rms(points.xy_px - truth), rms(points.xy_px[::-1] - truth)) < 0.01  # a board turned by half is the same board


def test_deep_images_keep_their_depth():
    image, truth = view()
    deep = np.rint(image * 200).astype(np.uint16)
    grey, fine = views.shade(dataclasses.replace(frame(deep), bit_depth=16, white_level_dn=65535))
    assert grey.dtype == np.uint8 and fine.dtype == np.uint16
    points = views.look(grey, fine, TARGET, views.detectors("checkerboard", None), 0.2)["symmetry"]
    assert rms(points.xy_px - truth) < 0.004


@pytest.mark.parametrize("said", [(8, 6), (9, 5), (5, 4), (6, 8)])
def test_a_larger_board_than_said_is_named(said):
    image, _ = view()
    grey = np.rint(image).astype(np.uint8)
    found = "9x6" if said[0] > said[1] else "6x9"
    with pytest.raises(BadInput, match=f"found {found}, you said {said[0]}x{said[1]}: count inner corners"):
        views.check_board_size([grey], [], Target(board=said), checkerboard)


def test_a_smaller_board_than_said_is_named_where_the_one_said_is_not_found():
    image, _ = view()
    grey = np.rint(image).astype(np.uint8)
    larger = Target(board=(10, 7))
    views.check_board_size([grey], [], larger, checkerboard)  # found in part: the rest may be out of the frame
    with pytest.raises(BadInput, match="found 9x6, you said 10x7"):
        views.check_board_size([], [grey], larger, checkerboard)
    for right in ((9, 6), (6, 9)):
        views.check_board_size([grey], [grey], Target(board=right), checkerboard)
        assert checkerboard.shown(grey, Target(board=right)) == right


def test_detectors_are_named():
    assert views.detectors("checkerboard", None) == [checkerboard, checkerboard_parts, checkerboard_sectors]
    assert views.detectors("checkerboard", "checkerboard_sectors") == [checkerboard_sectors]
    with pytest.raises(UsageError, match="charuco, checkerboard, circles"):
        views.detectors("chess", None)
    with pytest.raises(UsageError, match="not for the target circles"):
        views.detectors("circles", "charuco")


def frame(data):
    return Frame(data=data, kind="light", bit_depth=8, white_level_dn=255)
