"""Rendered boards against OpenCV: corner positions, a brute-force picture, a calibration that must find the truth."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from scipy.signal import fftconvolve

from calibench.errors import BadInput
from calibench.simulate.board import Board, BoardPose, corner_pixels, random_poses, render_board
from calibench.simulate.camera import stream, thesis_camera
from calibench.simulate.psf import flare
from calibench.simulate.sensor import expose

CAMERA = thesis_camera(1)
BOARD = Board(columns=9, rows=6, square_mm=25.0)
POSES = random_poses(CAMERA, BOARD, 16, stream(7, 0))
K, D = CAMERA.intrinsics.camera_matrix, CAMERA.intrinsics.distortion


def opencv_corners(pose: BoardPose) -> np.ndarray:
    return cv2.projectPoints(BOARD.corners_mm, np.array(pose.rotvec_rad), np.array(pose.translation_mm), K, D)[0][:, 0]


def psf_at(place: np.ndarray, half_px: int, samples: int) -> np.ndarray:
    """The PSF before the pixel, sum 1, finely sampled about the centre of mass."""
    weight, offset, radial, tangential, outward = dataclasses.astuple(flare(CAMERA.aberrations, place[None]))
    y, x = np.mgrid[-half_px * samples:half_px * samples + 1, -half_px * samples:half_px * samples + 1] / samples
    out, across = x * outward[0, 0] + y * outward[0, 1], y * outward[0, 0] - x * outward[0, 1]
    density = sum(w * np.exp(-(out - o) ** 2 / 2 / r - across**2 / 2 / t) / np.sqrt(r * t)
                  for w, (o,), (r,), (t,) in zip(weight, offset, radial, tangential, strict=True))
    return density / density.sum()


def brute_force(pose: BoardPose, centre: np.ndarray, reach: int, samples: int = 31) -> np.ndarray:
    """Pixels around `centre` of a hard-edged unbounded board, samples x samples jittered rays a pixel through OpenCV's
    undistortion, blurred by the lens's PSF at `centre` before the pixels add up."""
    pad = 8
    steps = np.arange(-(reach + pad) * samples - samples // 2, (reach + pad) * samples + samples // 2 + 1) / samples
    x, y = np.meshgrid(centre[0] + steps, centre[1] + steps)
    x, y = np.array([x, y]) + np.random.default_rng(0).uniform(-0.5, 0.5, (2, *x.shape)) / samples
    rays = cv2.undistortPointsIter(np.column_stack([x.ravel(), y.ravel()])[:, None], K, D, None, None, (3, 50, 1e-13))[:, 0]
    rotation = cv2.Rodrigues(np.array(pose.rotvec_rad))[0]
    to_board = np.linalg.inv(np.column_stack([rotation[:, :2], pose.translation_mm]))
    uvw = np.column_stack([rays, np.ones(len(rays))]) @ to_board.T
    squares = np.floor(uvw[:, :2] / uvw[:, 2:] / BOARD.square_mm).sum(axis=1).reshape(x.shape)
    fine = fftconvolve(np.where(squares % 2 == 0, 0.06, 1.0), psf_at(centre, pad, samples), mode="same")
    n = 2 * (reach + pad) + 1
    return fine.reshape(n, samples, n, samples).mean(axis=(1, 3))[pad:-pad, pad:-pad]


def test_true_corners_are_opencvs_projection():
    for pose in POSES:
        assert np.abs(corner_pixels(CAMERA, BOARD, pose) - opencv_corners(pose)).max() < 1e-6


@pytest.mark.parametrize("view", [0, 5, 11])
def test_rendered_corners_lie_where_brute_force_puts_them(view):
    pose, reach = POSES[view], 6
    picture = render_board(CAMERA, BOARD, pose, white_e=1.0) / CAMERA.transmission
    for corner in opencv_corners(pose)[::13]:
        x, y = np.rint(corner).astype(int)
        expected = brute_force(pose, np.array([x, y]), reach)
        rendered = picture[y - reach:y + reach + 1, x - reach:x + reach + 1]
        assert np.abs(rendered - expected).max() < 0.006
        by_y, by_x = np.gradient(expected)
        design = np.column_stack([by_x.ravel(), by_y.ravel(), np.ones(by_x.size), expected.ravel()])
        shift_px = np.linalg.lstsq(design, (expected - rendered).ravel(), rcond=None)[0][:2]
        assert np.abs(shift_px).max() < 0.003


def test_a_calibration_by_opencv_finds_the_camera():
    objects, images = [], []
    for i, pose in enumerate(POSES):
        light_e = render_board(CAMERA, BOARD, pose, white_e=3000.0)
        frame = expose(CAMERA, light_e, exposure_s=0.01, temperature_c=25.0, rng=stream(7, 1, i))
        truth = opencv_corners(pose).astype(np.float32)
        found = cv2.cornerSubPix(frame.astype(np.float32) / 4, truth[:, None].copy(), (5, 5), (-1, -1), (3, 50, 1e-4))[:, 0]
        clean = np.hypot(*(found - truth).T) < 0.15  # a defective pixel beside a corner moves it
        assert clean.mean() > 0.9
        objects.append(BOARD.corners_mm[clean].astype(np.float32))
        images.append(found[clean])
    rms, matrix, _, _, _, sd, *_ = cv2.calibrateCameraExtended(objects, images, (752, 480), None, None,
                                                               flags=cv2.CALIB_FIX_K3 | cv2.CALIB_USE_LU)
    sd_fx = float(sd[0, 0])
    assert rms < 0.06 and sd_fx < 1.0
    assert abs(matrix[0, 0] - CAMERA.intrinsics.fx_px) < 4 * sd_fx
    assert abs(matrix[1, 1] - CAMERA.intrinsics.fy_px) < 4 * float(sd[1, 0])


def test_all_squares_of_every_pose_are_on_the_image_and_the_poses_cover_it():
    corners = np.concatenate([corner_pixels(CAMERA, BOARD, pose) for pose in POSES])
    assert corners.min() > 0 and corners[:, 0].max() < 752 and corners[:, 1].max() < 480
    covered, *_ = np.histogram2d(corners[:, 0], corners[:, 1], bins=(6, 4), range=((0, 752), (0, 480)))
    assert (covered > 0).mean() > 0.9


def test_a_board_behind_the_camera_is_not_seen():
    pose = BoardPose(rotvec_rad=(0.0, 0.0, 0.0), translation_mm=(0.0, 0.0, -500.0))
    picture = render_board(CAMERA, BOARD, pose, white_e=1.0) / CAMERA.transmission
    assert np.ptp(picture) < 1e-12


def test_a_board_that_does_not_fit_is_refused():
    with pytest.raises(BadInput, match="does not fit"):
        random_poses(CAMERA, Board(columns=3, rows=40, square_mm=25.0), 2, stream(0))
