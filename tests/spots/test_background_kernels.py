"""The compiled statistics of cells against plain numpy."""

import numpy as np
import pytest

from calibench.spots import kernels
from calibench.spots.background import background_and_noise


def test_windows_are_cut_as_numpy_pads():
    image = np.arange(70, dtype=np.float32).reshape(7, 10)
    centre = np.array([[0, 0], [9, 6], [4, 3], [-5, 2]])
    padded = np.pad(image, 10, constant_values=-1)
    wanted = [padded[y + 8:y + 13, x + 8:x + 13] for x, y in centre]
    np.testing.assert_array_equal(kernels.cut(image, centre, 2, np.float32(-1)), wanted)


def test_cells_are_the_clipped_statistics_of_numpy():
    rng = np.random.default_rng(1)
    rows, columns = np.mgrid[:64, :96]
    image = (50 + 0.3 * columns - 0.1 * rows + rng.normal(0, 2, (64, 96))).astype(np.float32)
    image[rng.random(image.shape) < 0.02] += 500
    image[rng.random(image.shape) < 0.02] = np.nan
    level, noise = kernels.cell_statistics(image, 32, 0.1)
    assert level.shape == (2, 3)
    for r in range(2):
        for c in range(3):
            part = np.s_[r * 32:(r + 1) * 32, c * 32:(c + 1) * 32]
            values = image[part].ravel().astype(float)
            design = np.stack([np.ones(1024), columns[part].ravel() - 15.5 - c * 32, rows[part].ravel() - 15.5 - r * 32], -1)
            keep = np.abs(values - np.nanmedian(values)) < 30
            for _ in range(10):
                plane = np.linalg.lstsq(design[keep], values[keep], rcond=None)[0]
                left = values - design @ plane
                spread = np.sqrt((left[keep] ** 2).sum() / (keep.sum() - 3)) / kernels.INSIDE_CLIP
                keep = np.abs(left) < kernels.CLIP_SIGMA * spread
            assert level[r, c] == pytest.approx(plane[0], abs=0.02)
            assert noise[r, c] == pytest.approx(spread, rel=0.01)


def test_cells_are_interpolated_and_continued_linearly():
    y, x = np.mgrid[:75, :130]
    centre_y, centre_x = np.mgrid[:3, :5] * 32 + 15.5
    np.testing.assert_allclose(kernels.to_pixels(3 + 0.5 * centre_x - 0.2 * centre_y, 32, 75, 130), 3 + 0.5 * x - 0.2 * y,
                               rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(kernels.to_pixels(np.array([[7.0]]), 32, 10, 20), 7.0)


def test_drift_sees_a_risen_sky_and_louder_noise():
    rng = np.random.default_rng(2)
    shape = (260, 390)
    expected, noise = np.full(shape, 40, np.float32), np.full(shape, 3, np.float32)
    expected[5:9, 5:9] = np.nan
    data = np.rint(rng.normal(40, 3, shape)).astype(np.uint16)
    level, square = kernels.drift(data, expected, noise, 64, 16)
    assert np.abs(level).max() < 0.2 and square == pytest.approx(1.0, abs=0.03)
    level, square = kernels.drift(np.rint(rng.normal(43, 3.6, shape)).astype(np.uint16), expected, noise, 64, 16)
    assert np.median(level) == pytest.approx(0.95, abs=0.07) and square > 1.5


def test_crowded_points():
    rng = np.random.default_rng(3)
    xy = rng.uniform(0, 60, (80, 2))
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1) + 99 * np.eye(80)
    np.testing.assert_array_equal(kernels.crowded(xy, 4.0), apart.min(1) < 4.0)


def test_pixels_nearer_to_another_spot():
    rng = np.random.default_rng(5)
    xy = rng.uniform(10, 30, (12, 2))
    corner = np.rint(xy).astype(int) - 3
    found = kernels.nearer_to_another(xy, corner, 7)
    for n in range(12):
        for j in range(7):
            for i in range(7):
                distance = np.linalg.norm(xy - corner[n] - (i, j), axis=1)
                assert found[n, j, i] == (distance.argmin() != n)


def test_a_vignetted_corner_keeps_its_level():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:480, :640]
    level = 400 / (1 + 0.3 * ((x - 320) ** 2 + (y - 240) ** 2) / 320**2) ** 2
    background, noise = background_and_noise(rng.poisson(level))
    corner = np.s_[-24:, -24:]
    assert np.abs((background - level)[corner] / np.sqrt(level)[corner]).mean() < 0.12
    assert noise[corner].mean() == pytest.approx(np.sqrt(level[corner].mean()), rel=0.06)
