"""The chessboard views of ../shared/real: the published focal length and bow from any detector and any window."""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure import intrinsics
from calibench.measure.corners import _views as views
from calibench.measure.corners._target import Target
from calibench.records import Frame

MOST_CPU_S = 0.06  # four times what a view takes on a free machine


@pytest.fixture(scope="module")
def frames(real):
    return [Frame(data=cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), bit_depth=8, white_level_dn=255, file=file.name)
            for file in sorted((real / "boards" / "opencv").glob("*.jpg"))]


@pytest.mark.parametrize(("detector", "window"), [(None, 0.2), (None, 0.05), (None, 0.15), (None, 0.25), (None, 11.0),
                                                  ("checkerboard_sectors", 0.2)])
def test_any_detector_and_any_window(frames, detector, window):
    result = intrinsics.measure(frames, intrinsics.Settings(detector=detector, window=window))
    assert result.frames_used == 13
    assert 533.2 < result.quantity("fx_px").value < 533.9
    assert result.quantity("rms_px").value < 0.165
    assert result.quantity("outliers").value <= 0.02 * result.quantity("points").value
    assert -0.19 < result.quantity("board_bow_y_mm").value < -0.15


def test_a_smaller_board_than_the_true_one_is_told(frames):
    with pytest.raises(BadInput, match="found 9x6, you said 8x6"):
        intrinsics.measure(frames, intrinsics.Settings(board=(8, 6)))


def test_a_view_costs_milliseconds(frames):
    able, target = views.detectors("checkerboard", None), Target(board=(9, 6))
    best = np.full(len(frames), np.inf)
    for _ in range(3):
        for i, frame in enumerate(frames):
            start = time.process_time()
            views.look(*views.shade(frame), target, able, 0.2)
            best[i] = min(best[i], time.process_time() - start)
    assert best.mean() < MOST_CPU_S
