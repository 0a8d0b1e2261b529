"""Checkerboards of which a part is seen: the right corners under the right identity, or a refusal; never a silent shift."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.geometry.rotation import matrix_from_rotvec
from calibench.measure import intrinsics
from calibench.measure.corners import _views as views
from calibench.measure.corners import checkerboard, checkerboard_parts
from calibench.measure.corners._target import Target, Unsettled
from calibench.records import Frame
from calibench.simulate.board import Board, BoardPose, corner_pixels, render_board
from calibench.simulate.camera import thesis_camera

BOARD = (9, 6)
TARGET = Target(board=BOARD)
TILTED = (0.35, -0.3, 0.1)


def view(*, rotvec=TILTED, place_mm=(0.0, 0.0, 700.0), seed=0):
    """A view (H, W) uint8 of a board on white paper and its true corners (P, 2), also those off the frame; noise 2 DN."""
    camera, board = thesis_camera(), Board(columns=BOARD[0], rows=BOARD[1], square_mm=25.0)
    turn = matrix_from_rotvec(np.array(rotvec))
    pose = BoardPose(rotvec_rad=rotvec, translation_mm=tuple(np.array(place_mm) - turn @ (100.0, 62.5, 0.0)))
    light = 200 * render_board(camera, board, pose, white_e=1.0, blur_sigma_px=0.7) / camera.transmission
    noisy = light + np.random.default_rng(seed).normal(0, 2, light.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), corner_pixels(camera, board, pose)


def largest_error(xy, truth):
    """A board turned by half is the same board."""
    return min(float(np.nanmax(np.linalg.norm(xy - t, axis=1))) for t in (truth, truth[::-1]))


def frame(data, file=""):
    return Frame(data=data, kind="light", bit_depth=8, white_level_dn=255, file=file)


@pytest.mark.parametrize("turned", [0.0, np.pi / 2, np.pi, -np.pi / 2])
def test_the_whole_board_is_seen_either_way_up(turned):
    image, truth = view(rotvec=(0.3, 0.2, turned), place_mm=(0.0, 0.0, 900.0))
    xy = checkerboard_parts.find(image, TARGET)
    assert np.isfinite(xy).all() and largest_error(xy, truth) < 1


def test_a_hand_before_the_board_hides_corners_and_shifts_none():
    image, truth = view()
    centre = truth.reshape(6, 9, 2)[1, 2]
    cv2.circle(image, tuple(np.rint(centre).astype(int).tolist()), 45, 120, -1)
    xy = checkerboard_parts.find(image, TARGET)
    there = np.isfinite(xy[:, 0])
    assert 40 <= there.sum() < 54 and largest_error(xy, truth) < 1
    hidden = np.linalg.norm((truth if there[-1] else truth[::-1]) - centre, axis=1) < 45
    assert not there[hidden if np.nanmax(np.linalg.norm(xy - truth, axis=1)) < 1 else hidden[::-1]].any()


@pytest.mark.parametrize("place_mm", [(125.0, 50.0, 700.0), (-125.0, 50.0, 700.0), (125.0, -50.0, 700.0), (-140.0, 0.0, 700.0)])
def test_a_board_partly_off_the_frame_is_placed_by_its_visible_ends(place_mm):
    image, truth = view(place_mm=place_mm)
    xy = checkerboard_parts.find(image, TARGET)
    there = np.isfinite(xy[:, 0])
    assert 9 <= there.sum() < 54 and largest_error(xy, truth) < 1


def test_a_part_that_may_be_any_is_refused():
    image, _ = view(place_mm=(0.0, 0.0, 300.0))
    with pytest.raises(Unsettled, match="which part that is, is not settled"):
        checkerboard_parts.find(image, TARGET)
    with pytest.raises(Unsettled):
        views.look(image, image, TARGET, views.detectors("checkerboard", None), 0.2)


def test_a_board_of_another_size_is_no_part():
    image, _ = view()
    with pytest.raises(Unsettled, match="9x6 inner corners.*no part of 10x7"):
        checkerboard_parts.find(image, Target(board=(10, 7)))


@pytest.mark.parametrize("seed", range(4))
def test_a_covered_board_is_never_shifted(seed):
    """Strips of any direction and shade across the board: found right or refused."""
    rng = np.random.default_rng(seed)
    placed = 0
    for _ in range(8):
        image, truth = view(rotvec=(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-1, 1)), seed=seed)
        across = rng.normal(0, 1, 2)
        x, y = np.meshgrid(np.arange(image.shape[1]), np.arange(image.shape[0]))
        side = np.stack([x, y], -1) @ (across / np.linalg.norm(across)) - (truth.mean(axis=0) @ across) / np.linalg.norm(across)
        image[side > rng.uniform(30, 120)] = rng.integers(20, 240)
        try:
            xy = checkerboard_parts.find(image, TARGET)
        except Unsettled:
            continue
        if xy is not None:
            placed += 1
            assert largest_error(xy, truth) < 2
    assert placed >= 1


def test_views_of_parts_take_part_in_the_measurement():
    rng = np.random.default_rng(1)
    frames = []
    for i in range(9):
        off = (115.0 * (-1) ** i, 35.0, 0.0) if i < 4 else (0.0, 0.0, 0.0)
        place_mm = np.array([rng.uniform(-20, 20), rng.uniform(-10, 10), rng.uniform(680, 760)]) + off
        frames.append(frame(view(rotvec=(*rng.uniform(-0.45, 0.45, 2), 0.0), place_mm=place_mm, seed=i)[0], f"{i}.png"))
    frames.append(frame(view(place_mm=(0.0, 0.0, 300.0))[0], "near.png"))
    result = intrinsics.measure(frames, intrinsics.Settings(board=BOARD, model="brown4"))
    assert result.frames_used == 9
    count = np.bincount(result.evidence["corners_view"])
    assert (count[:4] < 54).sum() >= 3 and (count[4:] == 54).all()
    assert "not settled" in dict(result.frames_rejected)["near.png"]
    truth = thesis_camera().intrinsics
    assert abs(result.intrinsics.fx_px - truth.fx_px) < 4 * result.quantity("fx_px").uncertainty
    with pytest.raises(BadInput, match="found 9x6, you said 10x7"):
        intrinsics.measure(frames[4:8], intrinsics.Settings(board=(10, 7)))


def test_real_boards_behind_a_hand(real):
    """Random ellipses and cuts over real views: never a shifted corner."""
    rng, placed = np.random.default_rng(3), 0
    for file in sorted((real / "boards" / "opencv").glob("*.jpg")):
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        truth = checkerboard.find(image, TARGET)
        assert largest_error(checkerboard_parts.find(image, TARGET), truth) < 2
        low, high = truth.min(axis=0), truth.max(axis=0)
        for cut in (False, True):
            covered, first = image.copy(), np.zeros(2, int)
            if cut:
                first = np.rint(low + rng.uniform(0.02, 0.25, 2) * (high - low)).astype(int)
                covered = np.ascontiguousarray(covered[first[1]:, first[0]:])
            else:
                at, size = (np.rint(a).astype(int).tolist() for a in (rng.uniform(low, high), rng.uniform(30, 100, 2)))
                cv2.ellipse(covered, at, size, float(rng.uniform(0, 180)), 0, 360, int(rng.integers(20, 240)), -1)
            try:
                xy = checkerboard_parts.find(covered, TARGET)
            except Unsettled:
                continue
            placed += 1
            assert largest_error(xy + first, truth) < 3
    assert placed >= 8


def test_noise_is_no_board():
    noise = np.random.default_rng(4).integers(0, 255, (480, 640)).astype(np.uint8)
    assert checkerboard_parts.find(noise, TARGET) is None


def test_large_images_are_searched_in_larger_pixels():
    image, truth = view()
    large = cv2.resize(image, None, fx=4, fy=4, interpolation=cv2.INTER_CUBIC)
    xy = checkerboard_parts.find(large, TARGET)
    assert largest_error((xy - 1.5) / 4, truth) < 1
