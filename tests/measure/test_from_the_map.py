"""A map carries the observations: from the file alone the lens, its covariances and its held-out figures come back."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.calmap.assemble import assemble
from calibench.io.map_file import read_map, write_map
from calibench.measure import _board_lens as board_lens
from calibench.measure import intrinsics
from calibench.measure._bundle import covariance
from calibench.measure._bundle.left_out import left_out
from calibench.measure._bundle.outliers import Rejection
from calibench.records import Frame
from calibench.simulate.board import Board, BoardPose, render_board
from calibench.simulate.camera import thesis_camera


def frames(count=7):
    camera, board, rng = thesis_camera(), Board(columns=9, rows=6, square_mm=25.0), np.random.default_rng(2)
    for i in range(count):
        pose = BoardPose(rotvec_rad=(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.1, 0.1)),
                         translation_mm=(rng.uniform(-115, -85), rng.uniform(-70, -50), rng.uniform(680, 760)))
        light = 200 * render_board(camera, board, pose, white_e=1.0, blur_sigma_px=0.7) / camera.transmission
        noisy = np.clip(np.rint(light + rng.normal(0, 3, light.shape)), 0, 255).astype(np.uint8)
        yield Frame(data=noisy, kind="light", bit_depth=8, white_level_dn=255, file=f"{i}.png")


def test_the_lens_comes_back_from_the_map_s_observations(tmp_path):
    write_map(tmp_path / "map.fits", assemble([intrinsics.measure(frames(), intrinsics.Settings(board=(9, 6)))],
                                              software="test", created="2026-01-01"))
    calmap = read_map(tmp_path / "map.fits")
    kept = {key.removeprefix("intrinsics/"): array for key, array in calmap.evidence.items()}
    settings, lens = calmap.settings["intrinsics"], calmap.intrinsics

    points_mm, point = np.unique(kept["corners_board_mm"][:, ::-1], axis=0, return_inverse=True)  # row by row
    points_mm = np.ascontiguousarray(points_mm[:, ::-1])
    corners = np.full((len(kept["view_rms_px"]), len(points_mm), 2), np.nan)
    corners[kept["corners_view"], point] = kept["corners_xy_px"]
    rules = {"rejection": Rejection(sigma=settings["outlier_sigma"], most=settings["max_outliers"]),
             "worst_view": settings["worst_view"]}
    again, used = board_lens.solve(corners, points_mm, lens.image_size_px, lens.model, **rules)

    assert used.all()
    sd = np.sqrt(np.diag(lens.covariance))
    np.testing.assert_allclose(again.intrinsics.parameters / sd, lens.parameters / sd, atol=1e-6)
    np.testing.assert_allclose(covariance.recommended(again)[:8, :8], lens.covariance, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance.classical(again))), kept["uncertainty_classical"], rtol=1e-6)
    np.testing.assert_allclose(again.residual_px[kept["corners_view"], point], kept["residual_px"], atol=1e-6)
    left = left_out(again)
    np.testing.assert_allclose(np.sqrt(left.square_px2), kept["view_left_out_rms_px"], rtol=1e-6)
    assert left.rms_px == pytest.approx(calmap.quantities["intrinsics.leave_one_out_rms_px"].value, rel=1e-6)
    held_out = board_lens.held_out_px2(corners, points_mm, lens.image_size_px, lens.model, **rules)
    assert np.sqrt(held_out.mean()) == pytest.approx(calmap.quantities["intrinsics.held_out_rms_px"].value, rel=1e-6)
