"""A mosaic: each colour's width from its own pixels, and the shift of the colours that was put in."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.measure import psf
from calibench.measure._psf.colours import colour_pixels
from calibench.records import Frame, PsfMap
from calibench.spots.psf import light

SIZE = (300, 220)
MOMENT = {"r": 0.81, "g": 0.6, "b": 1.0}  # px^2
AT_CORNER_PX = {"r": 0.3, "g": 0.0, "b": -0.25}
LIGHT = {"r": 3e4, "g": 4e4, "b": 2.5e4}


def frame(rng, pattern="GRBG"):
    x, y = np.meshgrid(np.linspace(20, 280, 8), np.linspace(20, 200, 6))
    chief = np.stack([x.ravel(), y.ravel()], -1) + rng.uniform(-0.5, 0.5, (48, 2))
    image = np.full(SIZE[::-1], 20.0)
    for colour, pixels in colour_pixels(SIZE[::-1], pattern).items():
        lens = PsfMap(model="gaussian", degree=0, coefficients=np.array([[MOMENT[colour]], [MOMENT[colour]], [0.0]]), centre="",
                      image_size_px=SIZE, measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
        xy = chief + AT_CORNER_PX[colour] * (chief - (149.5, 109.5)) / (np.hypot(299, 219) / 2)
        for x, y in xy:
            window, column, row = np.arange(-9, 10), round(x), round(y)
            here = np.s_[row - 9:row + 10, column - 9:column + 10]
            image[here] += pixels[here] * LIGHT[colour] * light(lens, (x, y), column + window - x, row + window - y)
    data = np.rint(50 + 0.25 * (rng.poisson(image) + rng.normal(0, 8, image.shape))).clip(0, 65535).astype(np.uint16)
    return Frame(data=data, kind="light", bit_depth=16, white_level_dn=65535, egain_e_per_dn=4.0, bayer_pattern=pattern)


@pytest.fixture(scope="module")
def measured():
    rng = np.random.default_rng(1)
    return psf.measure([frame(rng) for _ in range(3)])


@pytest.mark.parametrize(("name", "colour"), [("fwhm_px", "g"), ("fwhm_px_r", "r"), ("fwhm_px_b", "b")])
def test_each_colour_has_its_own_width(measured, name, colour):
    assert measured.quantity(name).value == pytest.approx(2.3548 * np.sqrt(MOMENT[colour]), rel=0.02)


@pytest.mark.parametrize("colour", ["r", "b"])
def test_lateral_colour_is_found_within_its_error(measured, colour):
    figure = measured.quantity(f"lateral_colour_{colour}_px")
    assert abs(figure.value - AT_CORNER_PX[colour]) < 4 * figure.uncertainty < 0.03
    assert measured.evidence[f"lateral_{colour}_px"].shape == measured.evidence[f"lateral_{colour}_xy_px"].shape


def test_the_map_says_that_it_is_green(measured):
    assert any("green pixels" in warning for warning in measured.warnings)
    assert measured.psf.coefficients[0, 0] == pytest.approx(MOMENT["g"], abs=0.05)


def test_the_colours_of_a_cell():
    of = colour_pixels((2, 4), "RGGB")
    np.testing.assert_array_equal(of["r"], [[1, 0, 1, 0], [0, 0, 0, 0]])
    np.testing.assert_array_equal(of["g"], [[0, 1, 0, 1], [1, 0, 1, 0]])
