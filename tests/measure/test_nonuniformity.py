"""Nonuniformity: the high-pass by its definition, its noise gain, and noise taken off without a NaN."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from calibench.measure import _nonuniformity as spatial


def test_high_pass_is_the_three_filters_of_release_4():
    image = np.random.default_rng(0).normal(100, 3, (60, 80))
    smooth = ndimage.uniform_filter(ndimage.uniform_filter(image, 7, mode="reflect"), 11, mode="reflect")
    binomial = np.outer([1, 2, 1], [1, 2, 1]) / 16
    expected = image - ndimage.convolve(smooth, binomial, mode="reflect")
    np.testing.assert_allclose(spatial.high_pass(image), expected, atol=1e-10)


def test_noise_gain_is_what_white_noise_keeps():
    noise = np.random.default_rng(1).normal(0, 1, (1500, 1500))
    assert spatial.NOISE_GAIN == pytest.approx(0.98850, abs=5e-6)
    assert spatial.high_pass(noise)[20:-20, 20:-20].var() / noise.var() == pytest.approx(0.98850, abs=1e-3)


def test_lamp_fall_off_goes_and_pixel_pattern_stays():
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:300, :400]
    mean = 1000 - 1e-3 * ((x - 200) ** 2 + (y - 150) ** 2) + rng.normal(0, 5, x.shape) + rng.normal(0, 1, x.shape)
    assert spatial.split(mean, 1.0, filtered=False).total.sd > 10
    assert spatial.of_each_kind(mean, 1.0)["1288"].sd == pytest.approx(5 * 0.98850**0.5, rel=0.02)


def test_defects_carry_the_standard_figure_and_not_the_core():
    rng = np.random.default_rng(3)
    mean = rng.normal(0, 2, (500, 500))
    mean[rng.random(mean.shape) < 1e-3] += 80
    assert spatial.of_each_kind(mean, 0.0)["1288"].sd > 3
    assert spatial.of_each_kind(mean, 0.0)["core"].sd == pytest.approx(2, rel=0.03)


def test_a_negative_variance_gives_zero_and_keeps_its_sign():
    found = spatial.split(np.random.default_rng(4).normal(0, 1, (100, 100)), 1.2, filtered=False).total
    assert found.sd == 0 and found.signed_variance < 0 and found.uncertainty > 0


def test_error_bar_matches_the_scatter():
    rng = np.random.default_rng(5)
    lines = [rng.normal(0, 0.5, (64, 1)) + rng.normal(0, 0.8, 64) + rng.normal(0, 2, (64, 64)) for _ in range(300)]
    found = [spatial.of_each_kind(image + rng.normal(0, 1, (64, 64)), 1.0) for image in lines]
    for kind in spatial.KINDS:
        scatter, stated = np.std([f[kind].sd for f in found]), np.mean([f[kind].uncertainty for f in found])
        assert scatter == pytest.approx(stated, rel=0.15)


def test_a_few_hot_pixels_widen_the_error_of_the_standard_figure():
    rng = np.random.default_rng(6)
    found = []
    for _ in range(100):
        image = rng.normal(0, 1, (96, 96))
        image[rng.random(image.shape) < 5e-3] += 30
        found.append(spatial.of_each_kind(image, 0.0)["1288"])
    assert np.std([f.sd for f in found]) == pytest.approx(np.mean([f.uncertainty for f in found]), rel=0.25)


def test_the_split_is_that_of_release_4_in_plain_numpy():
    image = np.random.default_rng(7).normal(2000, 5, (61, 83)).astype(np.float32)
    h, w = image.shape
    plain = image.astype(float)
    s2, columns, rows = plain.var(), plain.mean(axis=0).var(), plain.mean(axis=1).var()
    rest = plain - plain.mean(axis=0) - plain.mean(axis=1, keepdims=True) + plain.mean()
    found = spatial.split(image, 0.0, filtered=False)
    assert found.total.signed_variance == pytest.approx(s2, rel=1e-9)
    assert found.column.signed_variance == pytest.approx(((h * w - h) * columns - w * (s2 - rows)) / (h * w - h - w), rel=1e-9)
    assert found.row.signed_variance == pytest.approx(((h * w - w) * rows - h * (s2 - columns)) / (h * w - h - w), rel=1e-9)
    lost = (1 - 1 / h) * (1 - 1 / w)
    error = np.sqrt(((rest**4).mean() - (rest**2).mean() ** 2) / (h * w) / lost) / lost
    assert found.pixel.uncertainty == pytest.approx(error / (2 * found.pixel.sd), rel=1e-9)
