"""The rendered PSF against SciPy's integrals and against its own moments taken from the pixels."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from calibench.simulate.camera import thesis_camera
from calibench.simulate.psf import Aberrations, chief_ray_px, moments_px2, render_sources

SIZE = (752, 480)
ABERRATIONS = thesis_camera().aberrations


def moments_of(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]]
    p = image / image.sum()
    x, y = (p * cols).sum(), (p * rows).sum()
    return np.array([x, y]), np.array([(p * (cols - x) ** 2).sum(), (p * (rows - y) ** 2).sum(),
                                       (p * (cols - x) * (rows - y)).sum()])


def test_round_psf_is_the_integral_of_a_gaussian_over_each_pixel():
    plain = Aberrations(core_sigma_px=0.5, radial_blur_px=0.0, tangential_blur_px=0.0, coma_px=0.0, centre_px=(20.0, 20.0),
                        corner_radius_px=28.0)
    x, y = 17.3, 22.8
    image = render_sources(plain, np.array([[x, y]]), np.array([1e4]), (41, 41))
    edges = np.arange(42) - 0.5
    expected = 1e4 * np.outer(np.diff(norm.cdf(edges, y, 0.5)), np.diff(norm.cdf(edges, x, 0.5)))
    assert np.abs(image - expected).max() < 1e-5 * expected.max()


@pytest.mark.parametrize("xy", [(379.8, 236.6), (600.31, 111.77), (20.4, 18.6), (730.25, 458.5)])
def test_pixels_have_the_stated_flux_centroid_and_moments(xy):
    image = render_sources(ABERRATIONS, np.array([xy]), np.array([5e4]), SIZE)
    centroid, moments = moments_of(image)
    assert image.sum() == pytest.approx(5e4, rel=1e-5)
    # Sampling alone, of exact integrals too, moves the centroid by up to 2.6e-4 px and the variance by 1.3e-3 px^2.
    assert centroid == pytest.approx(xy, abs=5e-4)
    assert moments == pytest.approx(moments_px2(ABERRATIONS, np.array([xy]))[0], abs=2e-3)


def test_coma_leaves_the_chief_ray_inward_in_proportion_to_the_field():
    centre = np.array(ABERRATIONS.centre_px)
    half, full = centre + [150.0, 100.0], centre + [300.0, 200.0]
    shift = [centre, half, full] - chief_ray_px(ABERRATIONS, np.array([centre, half, full]))
    assert shift[0] == pytest.approx([0, 0])
    assert shift[2] == pytest.approx(2 * shift[1])
    assert shift[2] == pytest.approx(ABERRATIONS.coma_px / ABERRATIONS.corner_radius_px * np.array([300.0, 200.0]))


def test_the_corner_is_astigmatic_along_the_radius_and_the_axis_round():
    axis, corner = moments_px2(ABERRATIONS, np.array([ABERRATIONS.centre_px, (740.0, 470.0)]))
    assert axis[0] == pytest.approx(axis[1]) and axis[2] == 0
    low, high = np.linalg.eigvalsh([[corner[0], corner[2]], [corner[2], corner[1]]])
    assert 1.15 < np.sqrt(high / low) < 1.6
    assert corner[2] > 0  # long axis towards the lower right corner, where both x and y grow


def test_a_source_beyond_the_edge_loses_what_falls_outside():
    image = render_sources(ABERRATIONS, np.array([[-0.5, 240.0], [-400.0, 240.0]]), np.array([1e4, 1e4]), SIZE)
    assert 0.3e4 < image.sum() < 0.7e4
