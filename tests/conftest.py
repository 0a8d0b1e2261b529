"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from calibench.geometry.projection import project
from calibench.geometry.rotation import matrix_from_rotvec
from calibench.measure._bundle.boards import board_points_mm, bow_shape

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's root folder."""
    return ROOT


@pytest.fixture(scope="session")
def real() -> Path:
    """The folder of real frames; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("CALIBENCH_REAL", ROOT.parent / "shared" / "real"))
    if not folder.is_dir():
        pytest.skip("real frames are not on this machine (set CALIBENCH_REAL to their folder)")
    return folder


@pytest.fixture(scope="session")
def board_corners():
    """Function of (lens, rng, ...) that gives the points (P, 3) mm of a board and its corners (V, P, 2) px before the lens."""
    def seen(lens, rng, *, views=13, sigma_px=0.1, bow_mm=(0.0, 0.0), board=(9, 6), square_mm=25.0):
        points = board_points_mm(board, square_mm)
        shaped = points + np.outer(bow_shape(points) @ bow_mm, (0, 0, 1))
        size, far = np.array(lens.image_size_px), np.ptp(points[:, 0]) * lens.fx_px / lens.image_size_px[0]
        out = []
        while len(out) < views:
            turn = matrix_from_rotvec(np.append(rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3)))
            place = np.append(rng.uniform(-0.35, 0.35, 2), 1) * rng.uniform(1.1, 2.0) * far
            xy = project(lens, (shaped - points.mean(axis=0)) @ turn.T + place)
            if ((xy > 3) & (xy < size - 4)).all():
                out.append(xy)
        return points, np.array(out) + rng.normal(0, sigma_px, (views, len(points), 2))
    return seen
