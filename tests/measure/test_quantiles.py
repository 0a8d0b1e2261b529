"""Quantiles by sorting against numpy's own."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.measure._quantiles import line_medians, quantiles, row_medians


def test_quantiles_are_the_nearest_pixels():
    image = np.random.default_rng(0).normal(size=(31, 47)).astype(np.float32)
    assert quantiles(image, (0.0, 0.25, 0.8413, 1.0)) == np.quantile(image, (0.0, 0.25, 0.8413, 1.0), method="nearest").tolist()


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_medians_of_rows(count):
    image = np.random.default_rng(count).normal(size=(3, 5, count)).astype(np.float32)
    np.testing.assert_array_equal(row_medians(image), np.median(image, axis=-1))


@pytest.mark.parametrize("axis", [0, 1])
def test_medians_of_lines_by_bands(axis):
    image = np.random.default_rng(3).normal(size=(600, 301)).astype(np.float32)
    np.testing.assert_array_equal(line_medians(image, axis), np.median(image, axis=axis))
