"""The compiled fit against the numpy one, against the Cramer-Rao bound, and its error bars against its errors."""

import numpy as np
import pytest
from scipy.special import erf

from calibench.spots.fit.known_shape import fit_windows, window_radius
from calibench.spots.gaussian_fit import fit_gaussians

READ_E, SKY_E, HALF = 4.0, 20.0, 10


def light(xy, sigma, side=2 * HALF + 1):
    edges = np.arange(side + 1) - 0.5
    x, y = (np.diff(erf((edges - xy[:, axis, None]) / (np.sqrt(2) * sigma)), axis=1) / 2 for axis in (0, 1))
    return y[:, :, None] * x[:, None, :]


def bound_px(xy, sigma, flux_dn, floor_dn2, gain):
    """Cramer-Rao bound of x and y (rms of the two), flux and background free, over a window that holds all the light."""
    step = 1e-4
    slopes = [flux_dn * (light(xy + move, sigma) - light(xy - move, sigma)) / 2 / step for move in step * np.eye(2)]
    unit = light(xy, sigma)
    jacobian = np.stack([*slopes, unit, np.ones_like(unit)], -1).reshape(len(xy), -1, 4)
    weight = 1 / (floor_dn2 + gain * flux_dn * unit).reshape(len(xy), -1, 1)
    covariance = np.linalg.inv(np.swapaxes(jacobian, 1, 2) @ (weight * jacobian))
    return np.sqrt(np.mean(np.trace(covariance[:, :2, :2], axis1=1, axis2=2) / 2))


@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize(("sigma", "flux_e", "most"), [(0.4, 500, 1.05), (0.4, 1e5, 1.05), (0.7, 2000, 1.05), (1.0, 1e5, 1.05),
                                                      (1.5, 1e4, 1.1)])
def test_the_fit_reaches_the_bound_with_honest_error_bars(bits, sigma, flux_e, most):
    """4000 spots a case: their rms scatters by 1.1 %, the normalised error squared by 1.6 %; so the tests stand 3 sigma wide.
    The full range holds the peak; read noise is at least 0.45 DN, so that rounding is dithered."""
    rng = np.random.default_rng(6)
    n, full = 4000, 2.0**bits - 1
    gain = min(1.0, 0.8 * full / (light(np.array([[10.0, 10]]), sigma).max() * flux_e + SKY_E))
    read = max(READ_E, 0.45 / gain)
    xy = HALF + rng.uniform(-0.5, 0.5, (n, 2))
    electrons = flux_e * light(xy, sigma) + SKY_E
    data = np.rint((rng.poisson(electrons) + rng.normal(0, read, electrons.shape)) * gain + 40 + rng.uniform(0, 1, (n, 1, 1)))
    floor = (read**2 + SKY_E) * gain**2 + 1 / 12
    moments = np.tile([sigma**2, sigma**2, 0.0], (n, 1))
    radius = window_radius(moments)
    data = data[:, HALF - radius:HALF + radius + 1, HALF - radius:HALF + radius + 1]
    start = xy + rng.normal(0, 0.1, (n, 2))
    found = fit_windows(data, np.full(data.shape, floor), np.full((n, 2), HALF - radius), start, moments,
                        gain_dn_per_e=gain, model_error=0.0)
    assert found.ok.all()
    error = found.xy_px - xy
    assert np.sqrt((error**2).mean()) / bound_px(xy[:200], sigma, flux_e * gain, floor, gain) < most
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance_px2), error) / 2
    assert np.mean(squares) == pytest.approx(1.0, abs=0.065)
    assert found.flux_dn.mean() == pytest.approx(flux_e * gain, rel=0.01)


def test_it_finds_what_the_plain_fit_finds():
    rng = np.random.default_rng(7)
    xy = np.array([[9.7, 10.2], [10.4, 9.9], [10.1, 10.4]])
    data = np.concatenate([rng.poisson(5000 * light(xy[k:k + 1], 0.9) + 30.0) for k in range(3)]).astype(np.float32)
    moments = np.array([[0.81, 0.81, 0.0], [0.9, 0.7, 0.2], [0.7, 0.9, -0.3]])
    radius = 4
    for k in range(3):
        floor = np.full((21, 21), 30.0, np.float32)
        plain = fit_gaussians(data[k], floor, np.zeros((21, 21), bool), xy[k:k + 1], moments[k:k + 1], gain_dn_per_e=1.0,
                              radius=radius)
        window = np.s_[HALF - radius:HALF + radius + 1]
        found = fit_windows(data[k:k + 1, window, window], floor[None, window, window], np.array([[HALF - radius] * 2]),
                            xy[k:k + 1], moments[k:k + 1], gain_dn_per_e=1.0, model_error=0.0)
        np.testing.assert_allclose(found.xy_px, plain.xy_px, atol=2e-3)  # the plain form's pixel integral is good to 1e-3
        np.testing.assert_allclose(found.flux_dn, plain.flux_dn, rtol=2e-3)
        if plain.chi2_per_dof[0] < 1.4:
            np.testing.assert_allclose(found.covariance_px2, plain.covariance[:, :2, :2], rtol=0.03, atol=1e-6)


def test_a_saturated_core_widens_the_error_bar_and_stays_honest():
    rng = np.random.default_rng(8)
    n, sigma = 2000, 1.0
    xy = HALF + rng.uniform(-0.5, 0.5, (n, 2))
    data = rng.poisson(60000 * light(xy, sigma) + 20.0).astype(float)
    data[data > 4095] = np.nan
    window = np.s_[:, HALF - 4:HALF + 5, HALF - 4:HALF + 5]
    found = fit_windows(data[window], np.full((n, 9, 9), 20.0), np.full((n, 2), HALF - 4), np.rint(xy),
                        np.tile([1.02 * sigma**2, 0.98 * sigma**2, 0.01], (n, 1)), gain_dn_per_e=1.0, model_error=0.1)
    error = (found.xy_px - xy)[found.ok]
    assert found.ok.mean() > 0.99
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance_px2[found.ok]), error) / 2
    assert 0.05 < np.mean(squares) < 1.05


def test_windows_that_tell_nothing_are_not_ok():
    empty = np.full((3, 7, 7), np.nan)
    empty[1, 3, 3] = 5
    empty[2] = 4.0
    found = fit_windows(empty, np.ones(empty.shape), np.zeros((3, 2)), np.full((3, 2), 3.0), np.tile([1.0, 1, 0], (3, 1)),
                        gain_dn_per_e=1.0, model_error=0.0)
    assert not found.ok[:2].any()
    assert not found.ok[2] or found.flux_dn[2] < 10
