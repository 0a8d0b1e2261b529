"""PSF: moments of the light before the pixel, over the field, from spots at known places."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure import psf
from calibench.records import Frame
from calibench.spots.psf import moments_at

SIZE = (400, 300)
SUB = 5


def moments(xy):
    """s_xx, s_yy, s_xy (N, 3) growing to the corner, long axis along x."""
    u = (xy - (200, 150)) / 200
    r2 = np.sum(u**2, axis=1)
    return np.stack([0.5 + 0.4 * r2, 0.5 + 0.1 * r2, 0.1 * u[:, 0] * u[:, 1]], -1)


def frame(rng, *, flux_e=20000.0, step=25, white=4095, file="", gain=0.1, extra=()):
    """Pinholes on a grid with random pixel phases, 5 x 5 samples a pixel."""
    x, y = np.meshgrid(np.arange(20, SIZE[0] - 12, step), np.arange(20, SIZE[1] - 12, step))
    xy = np.stack([x.ravel(), y.ravel()], -1) + rng.uniform(-0.5, 0.5, (x.size, 2))
    light = np.zeros(SIZE[::-1])
    sub = (np.arange(SUB) - (SUB - 1) / 2) / SUB
    for centre, (s_xx, s_yy, s_xy) in zip(xy, moments(xy), strict=True):
        column, row = np.rint(centre).astype(int)
        gx = (np.arange(column - 8, column + 9)[:, None] + sub).ravel() - centre[0]
        gy = (np.arange(row - 8, row + 9)[:, None] + sub).ravel() - centre[1]
        det = s_xx * s_yy - s_xy**2
        dx, dy = np.meshgrid(gx, gy)
        shape = np.exp(-0.5 * (s_yy * dx**2 - 2 * s_xy * dx * dy + s_xx * dy**2) / det) / (2 * np.pi * np.sqrt(det))
        light[row - 8:row + 9, column - 8:column + 9] += flux_e * shape.reshape(17, SUB, 17, SUB).mean(axis=(1, 3))
    for column, row in extra:
        light[row, column] += 3000
    data = np.rint(50 + gain * (rng.poisson(light + 20) + rng.normal(0, 8, light.shape)))
    return xy, Frame(data=np.clip(data, 0, white).astype(np.uint16), kind="light", bit_depth=12, white_level_dn=white,
                     egain_e_per_dn=1 / gain, file=file)


def test_moments_over_the_field_are_recovered():
    rng = np.random.default_rng(0)
    result = psf.measure([frame(rng, file=f"{i}.png")[1] for i in range(4)])
    xy = np.array([[200.0, 150.0], [40, 40], [360, 260], [40, 260]])
    np.testing.assert_allclose(moments_at(result.psf, xy), moments(xy), atol=0.03)
    spots = result.evidence["spot_xy_px"]
    truth = moments(spots)
    fwhm = 2.3548 * np.median((truth[:, 0] * truth[:, 1] - truth[:, 2] ** 2) ** 0.25)
    figure = result.quantity("fwhm_px")
    assert abs(figure.value - fwhm) < 0.02 and 0 < figure.uncertainty < 0.05
    assert result.frames_used == 4 and result.quantity("strehl").value is None
    half = np.hypot((truth[:, 0] - truth[:, 1]) / 2, truth[:, 2])
    middle = (truth[:, 0] + truth[:, 1]) / 2
    ellipticity = np.median(1 - np.sqrt((middle - half) / (middle + half)))
    assert result.quantity("ellipticity").value == pytest.approx(ellipticity, abs=0.02)


def test_encircled_energy_of_a_round_gaussian(monkeypatch):
    monkeypatch.setitem(globals(), "moments", lambda xy: np.tile([0.6, 0.6, 0.0], (len(xy), 1)))
    result = psf.measure([frame(np.random.default_rng(1), flux_e=30000, file=f"{i}.png")[1] for i in range(2)])
    recorded = 0.6 + 1 / 12
    assert result.quantity("ee80_radius_px").value == pytest.approx(np.sqrt(-2 * np.log(0.2) * recorded), rel=0.03)
    assert result.quantity("central_pixel_fraction").value == pytest.approx(0.2314, abs=0.005)  # erf(0.5/sqrt(1.2))^2
    assert result.quantity("ellipticity").value < 0.05


def test_hot_pixels_do_not_pass_for_spots():
    rng = np.random.default_rng(2)
    places = [(33, 33), (208, 133), (308, 58)]
    result = psf.measure([frame(rng, file=f"{i}.png", extra=places)[1] for i in range(2)])
    distance = np.linalg.norm(result.evidence["spot_xy_px"][:, None] - np.array(places), axis=-1).min(axis=1)
    assert distance.min() > 5


def test_saturated_spots_are_refused_with_a_remedy():
    with pytest.raises(BadInput, match=r"saturated[\s\S]*shorten the exposure"):
        psf.measure([frame(np.random.default_rng(3), flux_e=500000)[1]])


def test_too_few_spots_are_refused_with_the_reasons():
    with pytest.raises(BadInput, match="usable spots, 10 are the least"):
        psf.measure([frame(np.random.default_rng(4), step=200)[1]])
    empty = Frame(data=np.random.default_rng(5).normal(50, 2, SIZE[::-1]).astype(np.uint16), bit_depth=12, white_level_dn=4095)
    with pytest.raises(BadInput, match="usable spots"):
        psf.measure([empty])
