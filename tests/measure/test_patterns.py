"""Curves of a fixed pattern against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.measure._photon.patterns import spectrogram


@pytest.mark.parametrize("width", [1, 2, 63, 64, 330])
def test_a_spectrogram_is_the_root_of_the_mean_power_of_the_rows(width):
    image = np.random.default_rng(width).normal(3, 2, (41, width))
    power = np.abs(np.fft.rfft(image, axis=1)) ** 2 / width
    np.testing.assert_allclose(spectrogram(image), np.sqrt(power.mean(axis=0)), rtol=1e-5)
