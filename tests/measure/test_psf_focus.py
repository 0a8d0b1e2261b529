"""Through-focus series: the focal surface that was put in comes out within its errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure import psf
from calibench.measure._psf.figures import places
from calibench.measure._psf.focus import Series, surface_quantities
from calibench.records import Frame, PsfMap
from calibench.simulate.psf import render_sources
from calibench.simulate.pupil import Pupil
from calibench.spots.psf import light

SIZE = (300, 220)
HALF = np.hypot(299, 219) / 2
TRUTH = {"focus_best_um": None, "focus_tilt_x_um": 6.0, "focus_tilt_y_um": -4.0, "focus_curvature_um": 9.0}
CENTRE_UM, PER_UM2 = 3.0, 0.004  # position, and px^2 of moment a um^2 of defocus


def surface(xy):
    x, y = (xy - (149.5, 109.5)).T
    return CENTRE_UM + 6 * x / 299 - 4 * y / 219 + 9 * (x**2 + y**2) / HALF**2


def grid(rng):
    x, y = np.meshgrid(np.linspace(20, 280, 8), np.linspace(20, 200, 6))
    return np.stack([x.ravel(), y.ravel()], -1) + rng.uniform(-0.5, 0.5, (48, 2))


def exposed(image, rng, **said):
    data = np.rint(50 + 0.25 * (rng.poisson(image + 20) + rng.normal(0, 10, image.shape))).clip(0, 65535)
    return Frame(data=data.astype(np.uint16), kind="light", bit_depth=16, white_level_dn=65535, egain_e_per_dn=4.0, **said)


def frame(rng, focus_um):
    image = np.zeros(SIZE[::-1])
    for (x, y), z0 in zip(xy := grid(rng), surface(xy), strict=True):
        moment = 0.3 + PER_UM2 * (focus_um - z0) ** 2
        lens = PsfMap(model="gaussian", degree=0, coefficients=np.array([[moment], [moment], [0.0]]), image_size_px=SIZE,
                      centre="", measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
        window, column, row = np.arange(-10, 11), round(x), round(y)
        image[row - 10:row + 11, column - 10:column + 11] += 3e4 * light(lens, (x, y), column + window - x, row + window - y)
    return exposed(image, rng, focus_um=focus_um)


def series(seed, positions=(-20.0, -10.0, 0.0, 8.0, 16.0, 26.0)):
    rng = np.random.default_rng(seed)
    return [frame(rng, z) for z in positions]


@pytest.fixture(scope="module")
def measured():
    return psf.measure(series(0))


@pytest.mark.parametrize("name", TRUTH)
def test_the_focal_surface_is_found_within_its_error(measured, name):
    figure = measured.quantity(name)
    truth = TRUTH[name] if TRUTH[name] is not None else surface(places(SIZE)).mean()
    assert abs(figure.value - truth) < 4 * figure.uncertainty and 0 < figure.uncertainty < 0.6


def test_the_map_is_that_of_the_sharpest_position_and_the_curves_are_kept(measured):
    assert any("6 focus positions: the PSF map is that at 8 um" in warning for warning in measured.warnings)
    of = measured.evidence
    assert of["focus_um"][np.argmin(of["focus_moment_px2"])] == 8
    assert 0 < of["focus_centroid_bound_px"].min() < of["focus_centroid_bound_px"][0] / 1.5
    np.testing.assert_allclose(of["focus_surface_um"], surface(of["field_xy_px"]), atol=0.6)
    centroid, best = (measured.quantity(f"focus_{name}_um") for name in ("centroid", "best"))
    assert abs(centroid.value - best.value) < 1.5 and centroid.uncertainty > 0


def test_curvature_of_a_lens_rendered_from_its_pupil():
    """Defocus goes with z, field curvature of 0.3 waves at the corner moves the best focus there by as much the other way."""
    lens = Pupil(lambda_n_px=0.4, centre_px=(149.5, 109.5), corner_radius_px=HALF, curvature_waves=0.3, diffusion_sigma_px=0.4)
    rng, frames = np.random.default_rng(2), []
    for z in (-0.4, -0.2, 0.0, 0.2):
        image = render_sources(dataclasses.replace(lens, defocus_waves=z), xy := grid(rng)[::2], np.full(len(xy), 5e4), SIZE)
        frames.append(exposed(image, rng, focus_um=100 * z))
    curvature = psf.measure(frames).quantity("focus_curvature_um")
    assert curvature.value == pytest.approx(-30, abs=4 * curvature.uncertainty) and curvature.uncertainty < 2


def moments(seed):
    """Moments that flatten away from the focus, as those of fitted Gaussians do; each pinhole has a misfit of its own."""
    rng, positions = np.random.default_rng(seed), np.arange(-24.0, 31, 9)
    xy = grid(rng)
    away2 = (positions[:, None] - surface(xy)) ** 2
    size = 0.3 + PER_UM2 * away2 / (1 + away2 / 60**2) + rng.normal(0, 0.004, len(xy)) + rng.normal(0, 0.002, away2.shape)
    return Series(focus_um=positions, spot_focus_um=np.repeat(positions, len(xy)), xy_px=np.tile(xy, (len(positions), 1)),
                  moments_px2=np.repeat(size.ravel()[:, None], 3, axis=1), image_size_px=SIZE)


def test_the_errors_of_the_focal_surface_hold_over_seeds():
    found = [{q.name: q for q in surface_quantities(moments(seed))[0]} for seed in range(10)]
    for name in ("focus_tilt_x_um", "focus_tilt_y_um", "focus_curvature_um"):
        off = np.array([(one[name].value - TRUTH[name]) / one[name].uncertainty for one in found])
        assert 0.25 < np.sqrt(np.mean(off**2)) < 1.5 and np.abs(off).max() < 3, name


def test_of_three_positions_none_can_be_left_out_for_an_error():
    whole = moments(3)
    three = whole.take(np.isin(whole.spot_focus_um, whole.focus_um[2:5]))
    figure = surface_quantities(dataclasses.replace(three, focus_um=whole.focus_um[2:5]))[0][0]
    assert figure.value == pytest.approx(surface(places(SIZE)).mean(), abs=0.5)
    assert figure.uncertainty is None and "none can be left out" in figure.reason


def test_a_series_on_one_side_of_the_focus_has_no_best_one():
    found = psf.measure(series(1, (14.0, 20.0, 26.0)))
    figure = found.quantity("focus_best_um")
    assert figure.value is None and "both sides" in figure.reason


@pytest.mark.parametrize(("positions", "why"), [((0.0, 8.0), "needs 3"), ((0.0, None), "do not say their focus")])
def test_positions_that_are_no_series_are_refused(positions, why):
    rng = np.random.default_rng(3)
    frames = [dataclasses.replace(frame(rng, 4.0), focus_um=z) for z in positions]
    with pytest.raises(BadInput, match=why):
        psf.measure(frames)
