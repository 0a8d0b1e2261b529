"""A lens rendered from its pupil against Airy's formula, its own geometry, and the sum rule of a pinhole."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.special import j1

from calibench.errors import BadInput
from calibench.simulate.camera import thesis_camera
from calibench.simulate.psf import render_sources
from calibench.simulate.pupil import Pupil, coma_shift_px, stamps

WINDOW = np.arange(-19.0, 20.0)[None]
ALONG_X = np.array([[1.0, 0.0]])


def image(pupil: Pupil, field: float = 0.0, **options: float) -> np.ndarray:
    return stamps(pupil, np.array([field]), ALONG_X, WINDOW, WINDOW, **options)[0]


def lens(**aberrations: float) -> Pupil:
    return Pupil(lambda_n_px=1.2, centre_px=(0.0, 0.0), corner_radius_px=1.0, **aberrations)


@pytest.mark.parametrize("pixel", [(0, 0), (1, 0), (2, 1)])
def test_a_perfect_lens_draws_airys_disc_integrated_over_pixels(pixel):
    def airy(y, x):
        v = np.pi * np.hypot(x, y) / 1.2 or 1e-12
        return np.pi / (4 * 1.2**2) * (2 * j1(v) / v) ** 2
    x, y = pixel
    expected, _ = dblquad(airy, x - 0.5, x + 0.5, y - 0.5, y + 0.5)
    assert image(lens())[19 + y, 19 + x] == pytest.approx(expected, abs=4e-3)  # the pupil's rim is drawn in steps


def test_coma_throws_the_light_outward_of_the_chief_ray():
    coma = lens(coma_waves=0.04, diffusion_sigma_px=0.4)
    drawn = image(coma, 1.0)
    outward = coma_shift_px(coma, 1.0)
    # In the middle of the window stands the centre of mass, which the window moves by the wings that it cuts
    assert (drawn * WINDOW).sum() / drawn.sum() == pytest.approx(0, abs=0.06 * outward)
    assert drawn[19, 18] > 3 * drawn[19, 20]  # the peak stands inside it
    assert (drawn * WINDOW.T).sum() == pytest.approx(0, abs=1e-9)
    assert drawn.min() > -1e-9 and 0.96 < drawn.sum() < 1  # the rest lies in the wings


def test_a_pinhole_adds_its_own_variance():
    soft = lens(diffusion_sigma_px=0.6)
    near = np.abs(WINDOW) < 6  # the far wings, common to both, would drown the difference
    spread = [((i * WINDOW**2)[:, near[0]].sum() / i[:, near[0]].sum()) for i in (image(soft), image(soft, pinhole_px=1.0))]
    assert spread[1] - spread[0] == pytest.approx(1 / 16, rel=0.1)


def test_render_sources_takes_a_pupil_and_says_what_aberrations_cannot():
    coma = Pupil(lambda_n_px=0.5, centre_px=(30.0, 20.0), corner_radius_px=36.0, coma_waves=0.05, diffusion_sigma_px=0.4)
    xy = np.array([[44.3, 22.8]])
    drawn = render_sources(coma, xy, np.array([1e4]), (61, 41))
    place = np.array([(drawn * np.arange(61)).sum(), (drawn * np.arange(41)[:, None]).sum()]) / drawn.sum()
    assert place == pytest.approx(xy[0], abs=0.02)
    with pytest.raises(BadInput, match="points only"):
        render_sources(thesis_camera().aberrations, xy, np.array([1.0]), (61, 41), pinhole_px=0.5)
