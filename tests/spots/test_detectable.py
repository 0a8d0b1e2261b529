import numpy as np
import pytest
from scipy import integrate

from calibench.spots.detectable import CRITERIA, detectable_flux_e, limiting_magnitude, pixel_fractions


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
    assert len(CRITERIA) == 3
