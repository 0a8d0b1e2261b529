"""The PSF figures' errors against their scatter over seeds: a Gaussian lens, 54 spots a set."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.measure import psf
from calibench.records import Frame, PsfMap
from calibench.spots.psf import light

SIZE = (300, 220)
SETS = 6
NAMES = ("fwhm_px", "central_pixel_fraction", "effective_pixels", "ee50_radius_px", "fwhm_x_px", "mtf_nyquist_sagittal",
         "ensquared_3x3_fraction", "ellipticity_radial", "ellipticity_angle_deg")


def frame(rng):
    x, y = np.meshgrid(np.linspace(20, 280, 9), np.linspace(20, 200, 6))
    lens = PsfMap(model="gaussian", degree=0, coefficients=np.array([[0.7], [0.45], [0.1]]), image_size_px=SIZE, centre="",
                  measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
    image, window = np.full(SIZE[::-1], 20.0), np.arange(-9, 10)
    for at in np.stack([x.ravel(), y.ravel()], -1) + rng.uniform(-0.5, 0.5, (54, 2)):
        column, row = np.rint(at).astype(int)
        here = light(lens, at, column + window - at[0], row + window - at[1])
        image[row - 9:row + 10, column - 9:column + 10] += 2e4 * here
    data = np.rint(50 + 0.25 * (rng.poisson(image) + rng.normal(0, 10, image.shape))).astype(np.uint16)
    return Frame(data=data, kind="light", bit_depth=16, white_level_dn=65535, egain_e_per_dn=4.0)


@pytest.fixture(scope="module")
def sets():
    return [psf.measure([frame(np.random.default_rng(seed))]) for seed in range(SETS)]


@pytest.mark.parametrize("name", NAMES)
def test_the_error_is_the_scatter(sets, name):
    """Of 6 sets the scatter is known to 32 %, the averaged error of a jackknife to some 15 %."""
    found = [one.quantity(name) for one in sets]
    scatter = np.std([q.value for q in found], ddof=1)
    assert 0.3 < scatter / np.sqrt(np.mean([q.uncertainty**2 for q in found])) < 2.2
