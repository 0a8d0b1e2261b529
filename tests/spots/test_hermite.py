"""The Gauss-Hermite series against quadrature, its own moments and a Fourier sum; the compiled fit against a plain one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from calibench.records import HermiteShape, PsfMap
from calibench.spots import hermite
from calibench.spots.candidates import Candidates
from calibench.spots.centroid import psf_map
from calibench.spots.scene import FrameScene

SIZE = (101, 81)


def shape(order: int = 4, seed: int = 0) -> HermiteShape:
    """A lopsided spot that widens along x."""
    rng = np.random.default_rng(seed)
    functions = hermite.free_functions(order).shape[1]
    coefficients = np.zeros((functions, 3))
    coefficients[:, 0] = rng.normal(0, 0.006, functions)
    coefficients[0, 1] = 0.05
    coefficients[3, 2] = 0.04
    return HermiteShape(order=order, degree=1, scale_px=0.7, coefficients=coefficients, radius_px=5, core_residual=0.0,
                        dither_coverage=1.0)


def psf(one: HermiteShape) -> PsfMap:
    return PsfMap(model="gauss_hermite", degree=0, coefficients=np.array([[0.5], [0.5], [0.0]]), image_size_px=SIZE, centre="",
                  measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0, hermite=one)


@pytest.mark.parametrize("offset", [-1.3, 0.0, 0.45])
def test_functions_are_integrals_over_the_pixel_and_slopes_their_derivatives(offset):
    values, slopes = hermite.along(np.array([offset]), 0.6, 5)
    for n in range(6):
        def dense(x, n=n):
            return hermite.along(np.array([x]), 0.6, 5, pixel_px=0)[0][0, n]
        assert values[0, n] == pytest.approx(quad(dense, offset - 0.5, offset + 0.5)[0], abs=1e-9)
        assert slopes[0, n] == pytest.approx(dense(offset + 0.5) - dense(offset - 0.5), abs=1e-12)


def test_flux_is_one_and_the_centre_is_the_centre_of_mass_whatever_the_coefficients():
    window = np.arange(-14.0, 15.0)
    for seed in range(3):
        one = shape(6, seed)
        found = hermite.coefficients_at(one, np.array([[20.0, 70.0]]), SIZE)[0]
        image = hermite.image(found, one, window, window)
        assert image.sum() == pytest.approx(1, abs=1e-5)
        assert np.hypot((image * window).sum(), (image * window[:, None]).sum()) < 2e-4  # sampling alone moves it by 1e-4


def test_transfer_function_is_the_fourier_sum_of_the_image():
    one, fine = shape(), np.arange(-80, 81) / 10
    found = hermite.coefficients_at(one, np.array([[20.0, 70.0]]), SIZE)[0]
    dense = hermite.image(found, one, fine, fine, pixel_px=0) / 100
    for frequency in ([0.3, 0.0], [0.2, -0.4]):
        phase = np.exp(-2j * np.pi * (frequency[0] * fine + frequency[1] * fine[:, None]))
        assert hermite.transfer(found, one, np.array([frequency]))[0] == pytest.approx((dense * phase).sum(), abs=1e-5)


def plain_fit(scene: FrameScene, xy: np.ndarray, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """One spot, by numerical derivatives: x, y, flux, background and the covariance of x, y."""
    one, corner = scene.psf.hermite, np.rint(xy).astype(int) - radius
    columns, rows = corner[0] + np.arange(2 * radius + 1), corner[1] + np.arange(2 * radius + 1)
    data, floor = (a[np.ix_(rows, columns)] for a in (scene.signal_dn, scene.floor_variance_dn2))
    found = hermite.coefficients_at(one, xy[None], SIZE)[0]

    def model(p):
        return p[2] * hermite.image(found, one, columns - p[0], rows - p[1]) + p[3]
    p = np.array([*xy, data.sum(), 0.0])
    for _ in range(40):
        step = np.array([1e-4, 1e-4, 1.0, 1e-2])
        jacobian = np.stack([((model(p + d) - model(p - d)) / (2 * d.max())).ravel() for d in np.diag(step)], -1)
        unit = (model(p) - p[3]).ravel()
        weight = 1 / (floor.ravel() + (scene.gain_dn_per_e + one.core_residual**2 * unit.max()) * np.maximum(unit, 0))
        normal = jacobian.T @ (weight[:, None] * jacobian)
        p = p + np.linalg.solve(normal, jacobian.T @ (weight * (data - model(p)).ravel()))
    return p, np.linalg.inv(normal)[:2, :2]


def scene_of(xy: np.ndarray, flux_e: float, rng: np.random.Generator, one: HermiteShape) -> FrameScene:
    gain, light = 0.2, np.zeros(SIZE[::-1])
    for (x, y), place in zip(xy, hermite.coefficients_at(one, xy, SIZE), strict=True):
        light += flux_e * hermite.image(place, one, np.arange(SIZE[0]) - x, np.arange(SIZE[1]) - y)
    data = gain * (rng.poisson(np.maximum(light, 0) + 30) - 30 + rng.normal(0, 5, light.shape))
    return FrameScene(signal_dn=data.astype(np.float32), floor_variance_dn2=np.full(data.shape, gain**2 * 55, np.float32),
                 unusable=np.zeros(data.shape, bool), gain_dn_per_e=gain, psf=psf(one), psf_known=True)


def grid(rng: np.random.Generator) -> np.ndarray:
    x, y = np.meshgrid(np.arange(12, 95, 19), np.arange(12, 75, 19))
    return np.stack([x.ravel(), y.ravel()], -1) + rng.uniform(-0.5, 0.5, (x.size, 2))


def candidates(xy: np.ndarray) -> Candidates:
    n = len(xy)
    return Candidates(**{name: {"xy_px": xy, "peak_xy": np.rint(xy).astype(int)}.get(name, np.ones(n))
                         for name in Candidates.__dataclass_fields__})


def test_the_compiled_fit_is_the_plain_one():
    rng = np.random.default_rng(4)
    one, xy = shape(), grid(rng)
    scene, radius = scene_of(xy, 8000.0, rng, one), psf_map.window_radius(one)
    found = psf_map.centroid(scene, candidates(xy))
    for i in range(0, len(xy), 4):
        place, covariance = plain_fit(scene, xy[i], radius)
        assert [*found.xy_px[i], found.flux_dn[i], found.background_dn[i]] == pytest.approx(place, rel=2e-4, abs=2e-3)
        assert found.covariance_px2[i] == pytest.approx(covariance, rel=0.01, abs=1e-9)


@pytest.mark.parametrize("flux_e", [1500.0, 50000.0])
def test_the_centroid_is_unbiased_and_its_covariance_honest(flux_e):
    rng, one, errors, squares = np.random.default_rng(5), shape(), [], []
    for _ in range(60):
        xy = grid(rng)
        found = psf_map.centroid(scene_of(xy, flux_e, rng, one), candidates(xy + rng.normal(0, 0.2, xy.shape)))
        error = (found.xy_px - xy)[found.ok]
        errors.append(error)
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance_px2[found.ok]), error) / 2)
    error = np.concatenate(errors)
    assert len(error) >= 0.99 * 60 * 20
    assert np.mean(np.concatenate(squares)) == pytest.approx(1, abs=0.09)  # 1200 spots: 3 sigma
    assert np.abs(error.mean(0)).max() < 3.5 * error.std() / np.sqrt(len(error)) + 2e-4


def test_spots_that_cannot_be_fitted_say_so():
    rng, one = np.random.default_rng(6), shape()
    xy = np.array([[50.2, 40.3], [20.0, 20.0], [0.2, 40.0]])
    scene = scene_of(xy[:1], 5000.0, rng, one)
    scene.unusable[10:31, 10:31] = True
    found = psf_map.centroid(scene, candidates(xy))
    assert found.ok[0] and not found.ok[1]
    assert np.isfinite(found.covariance_px2[found.ok]).all()
