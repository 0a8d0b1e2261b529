"""The PSF from star frames, against a lens rendered from its pupil: fluxes spread over 1 to 50, places anywhere, hot clumps."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.calmap.correct import correct
from calibench.errors import BadInput
from calibench.measure import psf
from calibench.records import CalibrationMap, Frame
from calibench.simulate.psf import render_sources
from calibench.simulate.pupil import Pupil
from calibench.spots.find import find_spots

SIZE = (320, 240)
LENS = Pupil(lambda_n_px=0.4, centre_px=(160.0, 120.0), corner_radius_px=200.0, coma_waves=0.05, astigmatism_waves=0.1,
             diffusion_sigma_px=0.42)
HOT = np.array([[40, 50], [200, 61], [111, 171]])  # clumps of 2 x 2 that light the same pixels of every frame


def exposed(image, rng, **said):
    data = np.rint(100 + 0.25 * (rng.poisson(image + 30.0) + rng.normal(0, 10, image.shape))).clip(0, 65535)
    return Frame(data=data.astype(np.uint16), kind="light", bit_depth=16, white_level_dn=65535, egain_e_per_dn=4.0, **said)


def sky(rng, stars, file, places=None):
    xy = rng.uniform(2, np.array(SIZE) - 3, (stars, 2)) if places is None else places
    flux = 3e3 * 50 ** rng.random(len(xy))
    image = render_sources(LENS, xy, flux, SIZE)
    for column, row in HOT:
        image[row:row + 2, column:column + 2] += rng.uniform(4000, 6000)
    return exposed(image, rng, file=file)


@pytest.fixture(scope="module")
def measured():
    rng = np.random.default_rng(3)
    return psf.measure([sky(rng, 28, f"{i}.png") for i in range(7)], psf.Settings(from_stars=True))


def test_the_map_from_stars_leaves_no_phase_bias(measured):
    """A noise-free star at 3 x 3 phases about each of four places: its centroid through the map moves with it."""
    phases = np.stack(np.meshgrid([-1 / 3, 0, 1 / 3], [-1 / 3, 0, 1 / 3]), -1).reshape(-1, 2)
    corners = np.array([[40, 40], [240, 40], [40, 160], [160, 110]])
    steps = 20 * np.stack(np.meshgrid(range(3), range(3)), -1).reshape(-1, 2)
    true = (corners[:, None] + steps + phases).reshape(-1, 2)
    image = render_sources(LENS, true, np.full(len(true), 1e5), SIZE)
    frame = Frame(data=(image + 100).astype(np.float32), bit_depth=16, white_level_dn=1e9, egain_e_per_dn=1.0)
    assert measured.psf.hermite is not None
    spots = find_spots(correct(frame, CalibrationMap(image_size_px=SIZE)), measured.psf, psf_known=True, k_sigma=50.0)
    nearest = np.linalg.norm(spots.xy_px[:, None] - true, axis=-1).argmin(0)
    error = (spots.xy_px[nearest] - true).reshape(4, 9, 2)
    bias = error - error.mean(axis=1, keepdims=True)
    assert np.sqrt(np.mean(bias**2)) < 0.006 and np.abs(bias).max() < 0.025


def test_hot_clumps_stay_on_their_pixels_and_are_no_stars(measured):
    distance = np.linalg.norm(measured.evidence["spot_xy_px"][:, None] - (HOT + 0.5), axis=-1).min(1)
    assert distance.min() > 1.5
    assert any("at the same pixel in several frames" in warning for warning in measured.warnings)


def test_stars_that_do_not_sample_the_pixel_are_refused():
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(20, 310, 40), np.arange(20, 230, 40))
    still = np.stack([x.ravel(), y.ravel()], -1) + 0.1
    with pytest.raises(BadInput, match=r"12 % of the pixel's parts[\s\S]*other pointings"):
        psf.measure([sky(rng, 0, "a.png", still)], psf.Settings(from_stars=True))
