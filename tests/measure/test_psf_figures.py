"""What labs quote of a PSF beyond its width: direction, isotropy, chief rays, and the stars that the camera detects with it."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.measure import psf
from calibench.measure._psf.chief_rays import chief_ray_shifts
from calibench.measure._psf.figures import figures, figures_at, pixel_shares, places
from calibench.records import CalibrationMap, Frame, PsfMap, Quantity
from calibench.spots.detectable import detectable_flux_e, limiting_magnitude
from calibench.spots.psf import light

SIZE = (300, 220)


def gaussian(s_xx, s_yy, s_xy, degree=0):
    """A map of constant moments (or of polynomials, rows given) over the field."""
    rows = np.array([np.atleast_1d(s) for s in (s_xx, s_yy, s_xy)], float)
    return PsfMap(model="gaussian", degree=degree, coefficients=rows, image_size_px=SIZE, centre="", residual_rms_px2=0.0,
                  measured_xy_px=np.zeros((0, 2)))


def frame(xy, moments, rng, *, flux_e=20000.0, read_e=8.0, gain=0.1, **said):
    """Gaussian spots of moments (s_xx, s_yy, s_xy) at (N, 2); 20 e- of background."""
    lens, image = gaussian(*moments), np.full(SIZE[::-1], 20.0)
    for x, y in xy:
        column, row = round(x), round(y)
        window = np.arange(-9, 10)
        image[row - 9:row + 10, column - 9:column + 10] += flux_e * light(lens, (x, y), column + window - x, row + window - y)
    data = np.rint(50 + gain * (rng.poisson(image) + rng.normal(0, read_e, image.shape))).clip(0, 65535).astype(np.uint16)
    return Frame(data=data, kind="light", bit_depth=16, white_level_dn=65535, egain_e_per_dn=1 / gain, exposure_s=0.2, **said)


def grid(rng, step=37):
    x, y = np.meshgrid(np.arange(20, SIZE[0] - 12, step), np.arange(20, SIZE[1] - 12, step))
    return np.stack([x.ravel(), y.ravel()], -1) + rng.uniform(-0.5, 0.5, (x.size, 2))


def drawn_out(sigma_px, factor, angle_deg):
    """Moments of a Gaussian with its long axis, factor times the short one, at an angle from x towards y."""
    turn = np.radians(angle_deg)
    cos, sin, a, b = np.cos(turn), np.sin(turn), (sigma_px * factor) ** 2, sigma_px**2
    return a * cos**2 + b * sin**2, a * sin**2 + b * cos**2, (a - b) * cos * sin


@pytest.mark.parametrize("angle_deg", [30.0, -70.0])
def test_what_is_drawn_out_alike_everywhere_has_an_angle(angle_deg):
    rng = np.random.default_rng(1)
    found = psf.measure([frame(grid(rng), drawn_out(0.7, 1.3, angle_deg), rng)])
    angle, common = found.quantity("ellipticity_angle_deg"), found.quantity("ellipticity_common")
    assert abs(angle.value - angle_deg) < 4 * angle.uncertainty < 8
    assert common.value == pytest.approx(1 - 1 / 1.3, abs=4 * common.uncertainty) and common.uncertainty < 0.02
    assert abs(found.quantity("ellipticity_radial").value) < 0.02
    assert any("same direction" in warning for warning in found.warnings)


def test_round_spots_have_no_angle():
    rng = np.random.default_rng(2)
    found = psf.measure([frame(grid(rng), (0.5, 0.5, 0.0), rng)])
    angle = found.quantity("ellipticity_angle_deg")
    assert angle.value is None and "no common direction" in angle.reason
    assert not any("same direction" in warning for warning in found.warnings)


def test_a_lens_drawn_out_along_the_radius_has_no_common_direction():
    """s_xx - s_yy grows as x^2 - y^2, s_xy as x y (pixels): u is x over half the width, v is y over half the height."""
    ratio = ((SIZE[1] - 1) / (SIZE[0] - 1)) ** 2
    lens = gaussian([0.5, 0, 0, 0.2, 0, -0.2 * ratio], [0.5, 0, 0, -0.2, 0, 0.2 * ratio], [0, 0, 0, 0, 0.4 * ratio**0.5, 0], 2)
    values = figures(lens, 6)
    assert values["ellipticity_common"] < 0.01 < 0.1 < values["ellipticity_radial"]
    corner = figures_at(lens, np.array([[280.0, 200.0]]), 6)
    assert np.degrees(corner["angle_rad"][0]) == pytest.approx(np.degrees(np.arctan2(200 - 109.5, 280 - 149.5)), abs=2)


def test_figures_of_a_round_gaussian_are_those_of_the_integral():
    """EE80 of the recorded light: a Gaussian of 0.8 px through the pixel is one of nearly sqrt(0.64 + 1/12)."""
    at = figures_at(gaussian(0.64, 0.64, 0.0), np.array([[150.0, 110.0]]), 8)
    assert at["ee80_radius_px"][0] == pytest.approx(np.sqrt(-2 * np.log(0.2) * (0.64 + 1 / 12)), rel=0.01)
    values = figures(gaussian(0.64, 0.64, 0.0), 8)
    assert values["ee80_anisotropy"] == values["ellipticity_95"] == pytest.approx(0, abs=1e-9)
    shares = pixel_shares(gaussian(0.64, 0.64, 0.0), places(SIZE)[0], 6, 8)
    np.testing.assert_allclose(shares.sum((1, 2)), 1, atol=1e-6)
    assert shares[:, 6, 6].min() > shares[:, 6, 8].max()


def test_chief_rays_from_the_sidecar_give_the_shift():
    rng = np.random.default_rng(3)
    xy = [grid(rng) for _ in range(2)]
    frames = [frame(at, (0.5, 0.5, 0.0), rng, chief_rays_px=tuple(map(tuple, at - (0.3, 0.4)))) for at in xy]
    found = psf.measure(frames)
    shift = found.quantity("chief_ray_shift_px")
    assert shift.value == pytest.approx(0.5, abs=4 * shift.uncertainty) and shift.uncertainty < 0.005
    np.testing.assert_allclose(np.median(found.evidence["chief_ray_shift_px"], axis=0), (0.3, 0.4), atol=0.005)


def test_a_spot_far_from_every_chief_ray_has_no_shift():
    shift = chief_ray_shifts(np.array([[10.0, 10], [50, 50]]), np.zeros(2, int), [np.array([[10.5, 10.0]])])
    np.testing.assert_allclose(shift, [[-0.5, 0], [np.nan, np.nan]])


def noise_map(**layers):
    full = {"read_noise_dn": 0.8, "dark_rate_dn_per_s": 2.0, "offset_dn": 50.0} | layers
    arrays = {name: np.full(SIZE[::-1], value, np.float32) for name, value in full.items() if value is not None}
    read = Quantity(name="read_noise_e", value=8.0, uncertainty=0.4, unit="e-")
    return CalibrationMap(image_size_px=SIZE, measured=frozenset(arrays), **arrays, quantities={"dark.read_noise_e": read})


def test_the_faintest_star_is_that_of_the_closed_form():
    """Read noise 0.8 DN = 8 e-, dark 20 e-/s, sky 30 e-/s in 0.5 s: 9.43 e-; sigma 0.8 px."""
    rng = np.random.default_rng(4)
    settings = psf.Settings(star_exposure_s=0.5, sky_e_per_px_s=30.0, zero_point_mag=14.0)
    found = psf.measure([frame(grid(rng), (0.64, 0.64, 0.0), rng)], settings, noise_map())
    noise = found.quantity("pixel_noise_e")
    assert noise.value == pytest.approx(np.sqrt(64 + 10 + 15), rel=1e-3)
    assert noise.uncertainty == pytest.approx(0.05 * noise.value)
    for criterion in ("four_pixels", "plus", "matched", "ten_pixels"):
        star = found.quantity(f"star_{criterion}_e")
        expected = detectable_flux_e((0.8, 0.8), np.sqrt(89), 5.0, criterion)["median"]
        assert star.value == pytest.approx(expected, rel=0.04), criterion
        assert 0.04 < star.uncertainty / star.value < 0.1
        magnitude = found.quantity(f"star_{criterion}_mag")
        assert magnitude.value == pytest.approx(limiting_magnitude(star.value, 0.5, 14.0))
        assert magnitude.uncertainty == pytest.approx(1.0857 * star.uncertainty / star.value, rel=1e-3)
    full = found.quantity("star_saturated_e")
    assert full.value == pytest.approx((65535 - 51) / 0.1 / 0.17, rel=0.2)
    assert found.evidence["field_star_plus_e"].shape == (25,)


@pytest.mark.parametrize(("calmap", "missing"), [(None, "read noise, dark rate"),
                                                 (noise_map(dark_rate_dn_per_s=None), "dark rate")])
def test_what_is_missing_for_the_faintest_star_is_named(calmap, missing):
    rng = np.random.default_rng(5)
    found = psf.measure([frame(grid(rng), (0.64, 0.64, 0.0), rng)], None, calmap)
    assert found.quantity("star_plus_e").value is None
    assert f"not known: {missing} " in found.quantity("star_plus_mag").reason


def test_without_a_zero_point_there_is_a_flux_and_no_magnitude():
    rng = np.random.default_rng(6)
    found = psf.measure([frame(grid(rng), (0.64, 0.64, 0.0), rng)], None, noise_map())
    assert found.quantity("star_plus_e").value > 0 and "zero_point_mag" in found.quantity("star_plus_mag").reason
