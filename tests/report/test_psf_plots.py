"""The PSF section's plots: what centroids make of the map's light, the focus series, the faintest stars."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.records import HermiteShape, Measurement, PsfMap, Quantity
from calibench.report.sections._psf_series import focus_figure, stars_figure
from calibench.report.sections._spot_bias import bias_figure, errors_px

SIZE = (300, 200)
PHASES = np.column_stack([np.linspace(-0.5, 0.5, 9), np.zeros(9)])


def lens(skew=0.0):
    """A Gauss-Hermite map of sigma 0.7 px; skew: of its third order along x."""
    shape = None
    if skew:
        free = np.zeros((12 + 6, 1))  # core of order 2 to 4, and six wings
        free[3, 0] = skew
        shape = HermiteShape(order=4, degree=0, scale_px=0.7, coefficients=free, radius_px=6, core_residual=0.01,
                             dither_coverage=1.0)
    return PsfMap(model="gauss_hermite" if skew else "gaussian", degree=0, coefficients=np.array([[0.49], [0.49], [0.0]]),
                  image_size_px=SIZE, centre="", measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0, hermite=shape)


def test_the_centre_of_mass_of_three_pixels_swings_and_the_fit_does_not():
    place = np.array([150.0, 100.0])
    com = errors_px(lens(), place, PHASES, 1e5, "com")[:, 0]
    assert np.ptp(com[1:-1]) > 0.1 and abs(com[4]) < 1e-3  # 121 mpx at most for sigma 0.7 px, none in the pixel's middle
    assert np.abs(errors_px(lens(), place, PHASES, 1e5, "poisson")).max() < 1e-3


def test_only_the_map_follows_a_lopsided_spot_at_any_flux():
    place = np.array([150.0, 100.0])
    drift = {name: np.ptp([errors_px(lens(0.15), place, PHASES, flux, name)[:, 0].mean() for flux in (1e3, 1e5)])
             for name in ("poisson", "psf_map")}
    assert drift["psf_map"] < 5e-4 < 5e-3 < drift["poisson"]


def test_the_reading_says_by_how_much():
    figure = bias_figure(lens(0.15))
    assert figure.png.startswith(b"\x89PNG") and "the centre of mass swings by" in figure.reading
    assert "% of the peak, comes on top" in figure.reading


def measurement(best=6.5, reason=""):
    share = np.linspace(0.06, 0.94, 5)
    at = np.array([(a * 299, b * 199) for b in share for a in share])
    names = ("best", "centroid", "tilt_x", "tilt_y", "curvature")
    quantities = [Quantity(name=f"focus_{n}_um", value=best, uncertainty=0.1, unit="um", reason=reason) for n in names]
    stars = {"matched": 100.0, "four_pixels": 400.0, "plus": 900.0, "ten_pixels": 2500.0}
    quantities += [Quantity(name=f"star_{n}_e", value=v, uncertainty=1.0, unit="e-") for n, v in stars.items()]
    quantities += [Quantity(name=f"star_{n}_mag", value=None, unit="mag", reason="needs zero_point_mag") for n in stars]
    evidence = {"focus_um": np.array([-10.0, 0, 10]), "focus_moment_px2": np.array([1.0, 0.4, 0.9]), "field_xy_px": at,
                "focus_centroid_bound_px": np.array([0.02, 0.01, 0.018]), "focus_surface_um": np.linspace(4, 8, 25)}
    return Measurement(name="psf", image_size_px=SIZE, quantities=tuple(quantities),
                       evidence=evidence | {f"field_star_{n}_e": np.full(25, v) for n, v in stars.items()})


def test_focus_and_stars_are_drawn_with_their_readings():
    assert "6.50 ± 0.10 µm" in focus_figure(measurement()).reading
    assert "No best focus: one side" in focus_figure(measurement(None, "one side")).reading
    assert "from 900" in (said := stars_figure(measurement()).reading) and "100" in said and "e⁻" in said


@pytest.mark.parametrize("draw", [focus_figure, stars_figure])
def test_what_was_not_measured_is_not_drawn(draw):
    assert draw(Measurement(name="psf", image_size_px=SIZE)) is None
