"""What figures compute beyond their input: the projection's uncertainty, the PSF's shape and its rendered image."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.geometry import projection, rotation
from calibench.records import Intrinsics, PsfMap
from calibench.report.draw import grid_px, middle, sensor_sheet
from calibench.report.sections import _lens, psf
from calibench.spots.psf import light

LENS = Intrinsics(model="brown4", fx_px=900.0, fy_px=905.0, cx_px=320.0, cy_px=235.0, image_size_px=(640, 480),
                  distortion=np.array([-0.2, 0.05, 1e-3, -8e-4]),
                  covariance=np.diag([0.5, 0.4, 0.8, 0.6, 2e-3, 1e-2, 2e-4, 2e-4]) ** 2)


def disturbed(rng: np.random.Generator) -> Intrinsics:
    fx, fy, cx, cy, *distortion = rng.multivariate_normal(LENS.parameters, LENS.covariance)
    return dataclasses.replace(LENS, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=np.array(distortion))


def test_projection_uncertainty_is_what_random_lenses_show():
    """Against 3000 lenses drawn from the covariance, each with and without the rotation that fits the field best."""
    rng = np.random.default_rng(3)
    xy = grid_px(LENS.image_size_px, 8, 6)
    whole, rest = _lens.projection_sd_px(LENS, xy)
    rays = projection.unproject(LENS, xy)
    at, by_ray, _ = projection.project_with_jacobian(LENS, rays)
    by_turn = (by_ray @ -rotation.skew(rays)).reshape(-1, 3)
    shifts = np.array([projection.project(disturbed(rng), rays) - at for _ in range(3000)])
    turned = shifts.reshape(3000, -1)
    turned = (turned - (by_turn @ np.linalg.lstsq(by_turn, turned.T, rcond=None)[0]).T).reshape(shifts.shape)
    for found, seen in ((whole, shifts), (rest, turned)):
        assert found == pytest.approx(np.sqrt((seen**2).sum(2).mean(0) / 2), rel=0.06)
    assert rest.max() < 0.7 * whole.min()


def test_distortion_parts_add_up_to_the_lens():
    xy = grid_px(LENS.image_size_px, 7, 5)
    radial, tangential = _lens._parts(LENS, xy)
    rays = np.column_stack([(xy - [LENS.cx_px, LENS.cy_px]) / [LENS.fx_px, LENS.fy_px], np.ones(len(xy))])
    assert xy + radial + tangential == pytest.approx(projection.project(LENS, rays), abs=1e-9)
    assert 0 < np.hypot(*tangential.T).max() < 3 < np.hypot(*radial.T).max()


def test_thin_prism_terms_count_as_tangential():
    prism = np.array([1e-3, -2e-3, 1.5e-3, 5e-4])
    lens = dataclasses.replace(LENS, model="thin_prism12", distortion=np.r_[-0.2, np.zeros(7), prism], covariance=np.eye(16))
    xy = grid_px(LENS.image_size_px, 7, 5)
    x, y = ((xy - [lens.cx_px, lens.cy_px]) / [lens.fx_px, lens.fy_px]).T
    r2 = x**2 + y**2
    shift = np.column_stack([lens.fx_px * (prism[0] * r2 + prism[1] * r2**2), lens.fy_px * (prism[2] * r2 + prism[3] * r2**2)])
    radial, tangential = _lens._parts(lens, xy)
    assert tangential == pytest.approx(shift, abs=1e-9)
    assert radial == pytest.approx(-0.2 * r2[:, None] * (xy - [lens.cx_px, lens.cy_px]), abs=1e-9)


def test_a_fisheye_past_90_degrees_is_compared_with_the_equidistant_one():
    lens = Intrinsics(model="fisheye4", fx_px=180.0, fy_px=180.0, cx_px=320.0, cy_px=240.0, image_size_px=(640, 480),
                      distortion=np.array([-0.01, 0, 0, 0]), covariance=np.diag(np.full(8, 1e-3)) ** 2)
    radial, tangential = _lens._parts(lens, np.array([[320.0, 60.0], [640.0, 240.0]]))  # 1 rad up, 101.9 degrees to the right
    assert radial == pytest.approx(np.array([[0, 1.8], [-1.8 * (320 / 180) ** 3, 0]]))
    assert not tangential.any()
    field, curve = _lens.distortion(lens)
    assert "k1, k2, k3, k4" in field.reading and "tangential" not in field.reading
    assert curve.reading.startswith("Barrel") and "127.3 degrees" in curve.reading


def test_the_trusted_region_is_the_share_of_the_image_up_to_a_tenth_of_a_pixel():
    sd = _lens.projection_sd_px(LENS, grid_px(LENS.image_size_px, *_lens.FIELD))[1]
    share = 100 * np.mean(sd <= 0.1)
    assert 5 < share < 95
    assert f"{share:.1f} % of the image" in _lens.uncertainty(LENS).reading


def test_pixels_beyond_the_fold_have_no_uncertainty():
    folding = dataclasses.replace(LENS, distortion=np.array([-1.6, 0, 0, 0]))
    _, rest = _lens.projection_sd_px(folding, grid_px(LENS.image_size_px, 9, 7))
    assert np.isnan(rest[0]) and np.isfinite(rest[31])
    assert _lens.uncertainty(folding) is not None


def test_shape_of_a_turned_ellipse():
    major, minor, angle = 1.4, 0.8, np.radians(30)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    s = turn @ np.diag([major**2, minor**2]) @ turn.T
    flat = PsfMap(model="gaussian", degree=0, coefficients=np.array([[s[0, 0]], [s[1, 1]], [s[0, 1]]]), image_size_px=(50, 40),
                  centre="c", measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
    found = [float(value[0]) for value in psf.shape(flat, np.array([[10.0, 10.0]]))]
    assert found == pytest.approx([major, minor, angle])


def test_the_image_of_a_gaussian_map_holds_the_light_and_its_moments():
    flat = PsfMap(model="gaussian", degree=0, coefficients=np.array([[1.2], [0.7], [0.3]]), image_size_px=(50, 40), centre="c",
                  measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
    along = np.arange(-8.0, 9.0)
    image = light(flat, np.array([10.0, 10.0]), along, along)
    assert image.sum() == pytest.approx(1, abs=1e-4)
    moments = [(image * a).sum() for a in (along**2, along[:, None] ** 2, along * along[:, None])]
    assert moments == pytest.approx([1.2 + 1 / 12, 0.7 + 1 / 12, 0.3], abs=5e-3)  # a pixel adds 1/12 px^2


def test_limits_hold_the_middle_and_never_collapse():
    assert middle(np.r_[np.linspace(0, 1, 999), 1e6, np.nan]) == pytest.approx((0.01, 0.99), abs=5e-3)
    assert middle(np.full(9, 3.0)) == (2.5, 3.5)


@pytest.mark.parametrize("size", [(752, 480), (1000, 1000), (100, 4000)])
def test_a_sheet_has_the_sensors_proportions_and_a_bound(size):
    made, axes = sensor_sheet(size, columns=2, wide=True)
    width, height = made.get_size_inches()
    assert len(axes) == 2 and 1 < height <= 8 < width
