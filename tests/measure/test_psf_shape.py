"""The shape over the field, against a lens rendered from its pupil: never from the functions that are fitted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.measure import psf
from calibench.measure._psf.figures import strehl
from calibench.records import CENTRE_OF_MASS, Frame
from calibench.simulate.psf import render_sources
from calibench.simulate.pupil import Pupil
from calibench.spots.psf import light

SIZE = (300, 220)
LENS = Pupil(lambda_n_px=0.4, centre_px=(151.0, 108.0), corner_radius_px=186.0, coma_waves=0.055, astigmatism_waves=0.13,
             curvature_waves=0.05, diffusion_sigma_px=0.42)


def places(rng, nodes=7, dither=0.5):
    x, y = np.meshgrid(np.linspace(15, SIZE[0] - 16, nodes), np.linspace(15, SIZE[1] - 16, nodes))
    return np.rint(np.stack([x.ravel(), y.ravel()], -1)) + rng.uniform(-dither, dither, (nodes**2, 2))


def frame(xy, rng, *, lens=LENS, flux_e=4e4, file="", pinhole_px=0.0):
    """10 e- of read noise, 0.25 DN/e-."""
    image = render_sources(lens, xy, np.full(len(xy), flux_e), SIZE, pinhole_px=pinhole_px) + 20
    data = np.rint(50 + 0.25 * (rng.poisson(image) + rng.normal(0, 10, image.shape)))
    return Frame(data=data.clip(0, 65535).astype(np.uint16), kind="light", bit_depth=16, white_level_dn=65535,
                 egain_e_per_dn=4.0, pixel_size_um=5.5, file=file)


def series(count, seed=0, **options):
    rng = np.random.default_rng(seed)
    return [frame(places(rng), rng, file=f"{i}.png", **options) for i in range(count)]


def truth(xy, fine):
    """The lens's image at offsets `fine` from its centre of mass, pixel integrated, one sample a rendered frame."""
    out = np.empty((len(fine), len(fine)))
    middle = np.array([20.0, 20.0])
    for j, dy in enumerate(fine):
        for i, dx in enumerate(fine):
            at = middle - [dx, dy]
            moved = dataclasses.replace(LENS, centre_px=tuple(np.array(LENS.centre_px) - np.asarray(xy) + at))
            out[j, i] = render_sources(moved, at[None], np.ones(1), (41, 41))[20, 20]
    return out


@pytest.fixture(scope="module")
def measured():
    return psf.measure(series(4))


def test_the_map_holds_the_lens_to_a_few_thousandths_of_its_peak(measured):
    found = measured.psf
    assert found.model == "gauss_hermite" and found.centre == CENTRE_OF_MASS
    assert found.hermite.coefficients.nbytes < 50_000 and found.hermite.dither_coverage == 1
    fine = np.linspace(-1.6, 1.6, 5)
    for xy in ([150.0, 110.0], [40.0, 40.0], [270.0, 120.0]):
        expected = truth(xy, fine)
        image = light(found, xy, fine, fine)
        scale = (image * expected).sum() / (image**2).sum()  # wings beyond the window belong to nobody's flux
        assert np.sqrt(np.mean((scale * image - expected) ** 2)) < 0.006 * expected.max()
    assert found.hermite.core_residual < 0.006


def test_figures_have_errors_and_what_cannot_be_known_has_a_reason(measured):
    for name in ("fwhm_x_px", "effective_pixels", "mtf_nyquist_sagittal", "asymmetry", "magnitude_term_px", "ee50_radius_px"):
        assert measured.quantity(name).uncertainty > 0, name
    assert 0.4 < measured.quantity("central_pixel_fraction").value < 0.5
    assert measured.quantity("magnitude_term_px").value > 0.003
    for name in ("strehl", "chief_ray_shift_px"):
        assert measured.quantity(name).value is None and measured.quantity(name).reason


def test_strehl_is_one_without_aberrations_and_refused_where_the_pixel_hides_the_lens():
    perfect = Pupil(lambda_n_px=1.3, centre_px=LENS.centre_px, corner_radius_px=186.0)
    settings = psf.Settings(wavelength_um=0.55, f_number=13.0)
    found = psf.measure(series(2, lens=perfect, flux_e=2e5), settings)
    assert found.quantity("strehl").value == pytest.approx(1, abs=0.06)
    hidden = psf.measure(series(1), dataclasses.replace(settings, f_number=2.0))
    assert hidden.quantity("strehl").value is None and "hides" in hidden.quantity("strehl").reason
    assert strehl(found.psf, 2.6) > 2  # against a lens twice as slow the peak is higher


def test_a_pinholes_size_is_taken_out_on_request(measured):
    frames = series(2, pinhole_px=0.8, flux_e=1e5)
    wide, narrow = (psf.measure(frames, psf.Settings(pinhole_px=size)) for size in (0.0, 0.8))
    peaks = [m.quantity("central_pixel_fraction").value for m in (wide, narrow, measured)]
    assert peaks[0] < peaks[2] - 0.01
    assert peaks[1] == pytest.approx(peaks[2], abs=0.25 * (peaks[2] - peaks[0]))


@pytest.mark.parametrize(("frames", "dither", "why"), [(1, 0.5, "49 spots, a shape needs 60"), (3, 0.05, "pixel's parts")])
def test_too_little_gives_a_gaussian_and_says_so(frames, dither, why):
    rng = np.random.default_rng(8)
    found = psf.measure([frame(places(rng, dither=dither), rng, file=f"{i}.png") for i in range(frames)])
    assert found.psf.model == "gaussian" and found.psf.hermite is None
    assert any("a Gaussian only" in w and why in w for w in found.warnings)
    assert found.quantity("core_residual_percent").value is None
