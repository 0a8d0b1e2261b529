"""A skew of the image's axes: found with an honest error where it is asked for, kept by the map, refused by other formats."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench import registry
from calibench.calmap.assemble import assemble
from calibench.errors import BadInput
from calibench.io.map_file import read_map, write_map
from calibench.measure import _board_lens as board_lens
from calibench.measure._bundle import covariance
from calibench.measure._bundle.block import linearised
from calibench.measure._bundle.outliers import Rejection
from calibench.measure._bundle.start import posed
from calibench.records import Intrinsics, Measurement

SIZE = (640, 480)
TRUTH = Intrinsics(model="brown4", fx_px=530.0, fy_px=532.0, cx_px=322.0, cy_px=236.0, image_size_px=SIZE, skew_px=1.5,
                   distortion=[-0.28, 0.08, 1e-3, -5e-4], covariance=np.eye(9))
SESSIONS = 60


def test_a_skew_is_recovered_and_its_error_bar_is_honest(board_corners):
    rng = np.random.default_rng(0)
    points, clean = board_corners(TRUTH, rng, views=12, sigma_px=0)
    errors, said = [], []
    for _ in range(SESSIONS):
        solution, _ = board_lens.solve(clean + rng.normal(0, 0.1, clean.shape), points, SIZE, "brown4", skew_free=True,
                                       rejection=Rejection(sigma=4, most=0.03), worst_view=4)
        errors.append(solution.intrinsics.parameters - TRUTH.parameters)
        said.append(np.sqrt(np.diag(covariance.recommended(solution)))[:9])
    errors, said = np.array(errors), np.mean(said, axis=0)
    assert said[-1] < 0.1
    assert (np.abs(errors.mean(axis=0)) < 4 * said / np.sqrt(SESSIONS)).all()
    np.testing.assert_allclose(errors.std(axis=0) / said, 1, atol=0.3)


def test_rows_of_the_adjustment_are_the_derivatives(board_corners):
    points, corners = board_corners(TRUTH, np.random.default_rng(1), views=2, sigma_px=1)
    block = posed(TRUTH, corners, points, bow_free=True)
    gram, _, _ = linearised(block, TRUTH, lens_free=True)
    for i, gradient in enumerate(-2 * gram[:, :9, -1].sum(axis=0)):
        h = 1e-5 * np.eye(9)[i]
        up, down = (linearised(block, TRUTH.at(TRUTH.parameters + s * h), lens_free=True)[1] for s in (1, -1))
        assert (up - down) / 2e-5 == pytest.approx(gradient, rel=1e-4, abs=1e-2)
    moved = block.moved(np.zeros(2), np.eye(6)[[1, 1]] * 1e-6)
    back = block.moved(np.zeros(2), np.eye(6)[[1, 1]] * -1e-6)
    slope = (linearised(moved, TRUTH, lens_free=True)[1] - linearised(back, TRUTH, lens_free=True)[1]) / 2e-6
    assert slope == pytest.approx(-2 * gram[:, 12, -1].sum(), rel=1e-4)


def test_the_map_keeps_a_skew_and_exports_refuse_it(tmp_path):
    calmap = assemble([Measurement(name="intrinsics", image_size_px=SIZE, intrinsics=TRUTH)], software="test",
                      created="2026-01-01")
    write_map(tmp_path / "map.fits", calmap)
    assert read_map(tmp_path / "map.fits").intrinsics.skew_px == 1.5
    for name in registry.names("calibench.io.exports"):
        with pytest.raises(BadInput, match="skew of 1.5 px"):
            registry.load("calibench.io.exports", name).export(calmap, tmp_path / name)
    straight = dataclasses.replace(TRUTH, skew_px=None, covariance=np.eye(8))
    write_map(tmp_path / "map.fits", dataclasses.replace(calmap, intrinsics=straight))
    assert read_map(tmp_path / "map.fits").intrinsics.skew_px is None
