"""The PSF's shape in the map file: it comes back bit by bit, and a map without one reads as a Gaussian."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.io.map_file import encode_map, read_map, write_map
from calibench.records import CENTRE_OF_MASS, CalibrationMap, HermiteShape, PsfMap
from calibench.spots import hermite
from calibench.spots.psf import light

SIZE = (40, 30)


def mapped(shape):
    psf = PsfMap(model="gauss_hermite" if shape else "gaussian", degree=0, coefficients=np.array([[0.5], [0.4], [0.05]]),
                 image_size_px=SIZE, centre=CENTRE_OF_MASS, measured_xy_px=np.array([[3.0, 4.5]]), residual_rms_px2=0.01,
                 hermite=shape)
    return CalibrationMap(image_size_px=SIZE, measured=frozenset(["psf"]), psf=psf)


@pytest.fixture
def shape():
    functions = hermite.free_functions(4).shape[1]
    values = np.random.default_rng(3).normal(0, 0.02, (functions, 3))
    return HermiteShape(order=4, degree=1, scale_px=0.7, coefficients=values, radius_px=5, core_residual=0.002,
                        dither_coverage=0.94)


def test_the_shape_comes_back_bit_by_bit(shape, tmp_path):
    write_map(tmp_path / "map.fits", mapped(shape))
    found = read_map(tmp_path / "map.fits").psf
    np.testing.assert_array_equal(found.hermite.coefficients, shape.coefficients)
    for name in ("order", "degree", "scale_px", "radius_px", "core_residual", "dither_coverage"):
        assert getattr(found.hermite, name) == getattr(shape, name), name
    at, window = np.array([11.0, 22.0]), np.arange(-3.0, 4)
    np.testing.assert_array_equal(light(found, at, window, window), light(mapped(shape).psf, at, window, window))


def test_a_map_without_a_shape_reads_as_a_gaussian(tmp_path):
    write_map(tmp_path / "map.fits", mapped(None))
    found = read_map(tmp_path / "map.fits").psf
    assert found.hermite is None and found.model == "gaussian"
    assert b"PSF_HERMITE" not in encode_map(mapped(None))
