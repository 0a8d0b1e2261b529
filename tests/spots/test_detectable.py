import numpy as np
import pytest
from scipy import integrate

from calibench.spots.detectable import CRITERIA, detectable_flux_e, least_flux, limiting_magnitude, pixel_fractions


def test_pixel_fractions_integrate_the_gaussian():
    fraction = pixel_fractions((0.7, 1.1), np.array([[0.2, -0.3]]))[0]
    wanted, _ = integrate.dblquad(lambda y, x: np.exp(-((x - 0.2) / 0.7) ** 2 / 2 - ((y + 0.3) / 1.1) ** 2 / 2)
                                  / (2 * np.pi * 0.77), 0.5, 1.5, -0.5, 0.5)
    assert fraction[4, 5] == pytest.approx(wanted, rel=1e-6)
    assert fraction.sum() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(("sigma", "plus", "plus_worst", "four_worst"), [(0.5, 275, 2728, 464), (0.8, 268, 754, 344),
                                                                        (1.0, 320, 638, 378)])
def test_the_thesis_criterion_at_29_6_electrons(sigma, plus, plus_worst, four_worst):
    """Independent figures for a threshold of 29.6 e- (5 sigma): centred plus, its worst phase, any four pixels at worst."""
    found = detectable_flux_e((sigma, sigma), 29.6 / 5, 5.0, "plus")
    assert found["centred"] == pytest.approx(plus, rel=0.01) and found["worst"] == pytest.approx(plus_worst, rel=0.01)
    assert detectable_flux_e((sigma, sigma), 29.6 / 5, 5.0, "four_pixels")["worst"] == pytest.approx(four_worst, rel=0.02)


def test_a_matched_filter_sees_fainter_and_a_magnitude_follows():
    matched, four = (detectable_flux_e((0.8, 0.8), 6.0, 5.0, c)["median"] for c in ("matched", "four_pixels"))
    assert matched < four / 2
    assert limiting_magnitude(matched / 10, 0.1, 15.0) == pytest.approx(limiting_magnitude(matched, 0.1, 15.0) + 2.5)
    assert limiting_magnitude(100.0, 1.0, 15.0) == pytest.approx(10.0)


@pytest.mark.parametrize("wrong", [((0.0, 1), 5, 5, "plus"), ((1, 1), 0, 5, "plus"), ((1, 1), 5, 5, "star")])
def test_what_makes_no_sense_is_refused(wrong):
    with pytest.raises(ValueError):
        detectable_flux_e(*wrong)


@pytest.mark.parametrize(("sigma", "ceiling"), [(0.5, 5400), (0.7, 1300), (0.8, 1000), (1.0, 770), (1.5, 810)])
def test_the_ceiling_of_nine_pixels_rejects_bright_stars(sigma, ceiling):
    """Independent figures of the flux above which a tenth pixel is lit at 29.6 e-, at a quarter of the phases."""
    steps = np.linspace(-0.5, 0.5, 41)
    phases = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    flux = least_flux(pixel_fractions((sigma, sigma), phases), 29.6, "ten_pixels")
    assert np.percentile(flux, 25) == pytest.approx(ceiling, rel=0.06)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_criteria_by_hand(criterion):
    """Shares 0.3 in the peak, on the window's rim, so that one arm of the plus is dark; 0.1, 0.08 ... around."""
    light = np.array([[[0.3, 0.1, 0.02, 0.01], [0.1, 0.08, 0.02, 0.01], [0.05, 0.01, 0.01, 0.005]]])
    wanted = {"plus": np.inf, "four_pixels": 10 / 0.08, "ten_pixels": 10 / 0.01, "matched": 10 / np.sqrt((light**2).sum())}
    assert least_flux(light, 10.0, criterion)[0] == pytest.approx(wanted[criterion])
