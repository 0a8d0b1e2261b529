"""A tilted Gaussian through the pixel, against the bivariate normal's own distribution function."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calibench.records import PsfMap
from calibench.spots.psf import light


@pytest.mark.parametrize("moments", [(0.7, 0.45, 0.1), (0.3, 0.3, 0.0), (1.0, 2.0, -1.2), (0.16, 0.16, 0.14)])
@pytest.mark.parametrize("pixel_px", [1.0, 0.0])
def test_light_is_that_of_the_bivariate_normal(moments, pixel_px):
    psf = PsfMap(model="gaussian", degree=0, coefficients=np.array(moments)[:, None], image_size_px=(40, 30), centre="",
                 measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
    dx, dy = np.array([-1.7, -0.3, 0.0, 1.1]), np.array([-0.8, 0.4, 2.2])
    normal = multivariate_normal([0, 0], [[moments[0], moments[2]], [moments[2], moments[1]]])
    at = np.stack(np.meshgrid(dx, dy), -1)
    if pixel_px:
        expected = sum(a * b * normal.cdf(at + 0.5 * np.array([a, b])) for a in (-1, 1) for b in (-1, 1))
    else:
        expected = normal.pdf(at)
    np.testing.assert_allclose(light(psf, (3.0, 4.0), dx, dy, pixel_px=pixel_px), expected, atol=2e-8)
