"""The compiled statistics of cells against plain numpy."""

import numpy as np
import pytest

from calibench.records import PsfMap
from calibench.spots import kernels
from calibench.spots.background import background_and_noise
from calibench.spots.psf import field_terms, moments_at


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


def drift(data, expected, noise):
    smooth = np.empty((5, 7))
    return smooth, kernels.drift(data, expected, noise, 64, 16, smooth)


def test_drift_sees_a_risen_sky_and_louder_noise():
    rng = np.random.default_rng(2)
    shape = (260, 390)
    expected, noise = np.full(shape, 40, np.float32), np.full(shape, 3, np.float32)
    expected[5:9, 5:9] = np.nan
    data = np.rint(rng.normal(40, 3, shape)).astype(np.uint16)
    level, square = drift(data, expected, noise)
    assert np.abs(level).max() < 0.2 and square == pytest.approx(1.0, abs=0.03)
    level, square = drift(np.rint(rng.normal(43, 3.6, shape)).astype(np.uint16), expected, noise)
    assert np.median(level) == pytest.approx(0.95, abs=0.07) and square > 1.5


def test_pixels_nearer_to_another_spot():
    rng = np.random.default_rng(5)
    xy = rng.uniform(10, 30, (12, 2))
    corner = np.rint(xy).astype(int) - 3
    found = np.zeros((12, 7, 7), np.float32)
    kernels.lose_others(xy, corner, found)
    for n in range(12):
        for j in range(7):
            for i in range(7):
                distance = np.linalg.norm(xy - corner[n] - (i, j), axis=1)
                assert np.isnan(found[n, j, i]) == (distance.argmin() != n)


def test_moments_are_the_polynomials_of_the_field():
    rng = np.random.default_rng(6)
    coefficients, xy = rng.normal(0, 0.05, (3, 10)), rng.uniform(0, 99, (20, 2))
    coefficients[:2, 0] += 0.8
    psf = PsfMap(model="gaussian", degree=3, coefficients=coefficients, image_size_px=(100, 80), centre="",
                 measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
    np.testing.assert_allclose(moments_at(psf, xy), field_terms(xy, (100, 80), 3) @ coefficients.T, rtol=1e-12)


def test_a_vignetted_corner_keeps_its_level():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:480, :640]
    level = 400 / (1 + 0.3 * ((x - 320) ** 2 + (y - 240) ** 2) / 320**2) ** 2
    background, noise = background_and_noise(rng.poisson(level))
    corner = np.s_[-24:, -24:]
    assert np.abs((background - level)[corner] / np.sqrt(level)[corner]).mean() < 0.12
    assert noise[corner].mean() == pytest.approx(np.sqrt(level[corner].mean()), rel=0.06)
