"""Lenses of other programs: what we export comes back the same, what they wrote comes in with their numbers."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calibench import registry
from calibench.errors import BadInput, UsageError
from calibench.io.imported_lens import imported_lens
from calibench.records import CalibrationMap, Intrinsics

SIZE = (752, 480)
DISTORTION = {"pinhole": [], "brown4": [-0.11, 0.2, 1e-4, -3e-7], "brown5": [-0.11, 0.2, 1e-4, -3e-7, 0.013],
              "rational8": [-0.11, 0.2, 1e-4, -3e-7, 0.013, 0.4, -0.01, 1 / 3]}
MATRIX = np.array([[533.1, 0, 320.25], [0, 534.2, 241.5], [0, 0, 1]])


def lens(model: str) -> Intrinsics:
    n = 4 + len(DISTORTION[model])
    root = np.random.default_rng(n).normal(size=(n, n))
    covariance = root @ root.T
    return Intrinsics(model=model, fx_px=1416.7 + 1e-10, fy_px=1417.0, cx_px=375.5, cy_px=239.125, image_size_px=SIZE,
                      distortion=DISTORTION[model], covariance=(covariance + covariance.T) / 2)


def read(name: str, path) -> Intrinsics:
    return registry.load("calibench.io.imports", name).read(path)


@pytest.mark.parametrize("name", registry.names("calibench.io.imports"))
@pytest.mark.parametrize("model", DISTORTION)
def test_an_export_comes_back_with_identical_numbers(tmp_path, name, model):
    path, given = tmp_path / "camera", lens(model)
    calmap = CalibrationMap(image_size_px=SIZE, intrinsics=given, measured=frozenset(["intrinsics"]))
    registry.load("calibench.io.exports", name).export(calmap, path)
    back = read(name, path)
    assert (back.model, back.image_size_px, back.mirrored) == (model, SIZE, False)
    np.testing.assert_array_equal(back.parameters, given.parameters)
    if name == "opencv_yaml":
        np.testing.assert_array_equal(back.covariance, given.covariance)
    else:
        assert np.isinf(np.diag(back.covariance)).all()


def test_the_published_models_of_mrcal(real):
    for path in sorted((real / "boards" / "figueroa").glob("*.cameramodel")):
        found = read("mrcal_cameramodel", path)
        assert (found.model, found.image_size_px) == ("rational8", (6016, 4016))
        np.testing.assert_allclose(found.parameters[:4], [2073.87, 2077.45, 3004.69, 1997.38], atol=0.005)
        assert found.distortion[0] == 0.4791613797 and found.distortion[-1] == 0.001407513313


def written_by_opencv(path, distortion, **more) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.writeComment("calibration of the bench camera")
    values = {"calibration_time": "Tue 12 May 2020 10:11:12", "image_width": 640, "image_height": 480,
              "camera_matrix": MATRIX, "distortion_coefficients": np.asarray(distortion, float),
              "per_view_reprojection_errors": np.arange(30.0)} | more
    for name, value in values.items():
        storage.write(name, value)
    storage.release()


@pytest.mark.parametrize(("count", "model"), [(4, "brown4"), (5, "brown5"), (8, "rational8")])
@pytest.mark.parametrize("column", [False, True])
def test_what_opencv_writes_comes_in(tmp_path, count, model, column):
    path, terms = tmp_path / "camera.yml", np.random.default_rng(count).normal(0, 0.1, count)
    written_by_opencv(path, terms[:, None] if column else terms[None])
    found = read("opencv_yaml", path)
    assert (found.model, found.image_size_px) == (model, (640, 480))
    np.testing.assert_array_equal(found.parameters, [533.1, 534.2, 320.25, 241.5, *terms])
    assert np.isinf(np.diag(found.covariance)).all()


def test_the_six_zeros_that_calibrate_camera_appends_are_left_out(tmp_path):
    path = tmp_path / "camera.yml"
    written_by_opencv(path, [[*DISTORTION["rational8"], *[0.0] * 6]])
    np.testing.assert_array_equal(read("opencv_yaml", path).distortion, DISTORTION["rational8"])


@pytest.mark.parametrize("name", registry.names("calibench.io.imports"))
def test_line_ends_of_windows_make_no_difference(tmp_path, name):
    path, given = tmp_path / "camera", lens("brown5")
    calmap = CalibrationMap(image_size_px=SIZE, intrinsics=given, measured=frozenset(["intrinsics"]))
    registry.load("calibench.io.exports", name).export(calmap, path)
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    np.testing.assert_array_equal(read(name, path).parameters, given.parameters)


def test_the_layout_of_opencv_5(tmp_path):
    path = tmp_path / "camera.yml"
    path.write_text("""\
%YAML 1.2
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 501., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-nd-matrix
   sizes: [ 5 ]
   dt: d
   data: [ -1.0e-01, 2.0e-02, 0., 0.,
       3.0e-03 ]
""")
    np.testing.assert_array_equal(read("opencv_yaml", path).parameters, [500, 501, 320, 240, -0.1, 0.02, 0, 0, 0.003])


@pytest.mark.parametrize(("distortion", "more", "complaint"), [
    ([[0.1, 0.2, 0, 0, 0, 0, 0, 0, 1e-3, 0, 0, 0]], {}, "12 distortion coefficients, 9 without zeros .* a known model"),
    ([[0.1, 0.2, 0]], {}, "its 3 distortion coefficients"),
    ([[0.1, 0.2, 0, 0]], {"fisheye_model": 1}, "fisheye"),
    ([[0.1, 0.2, 0, 0]], {"camera_matrix": MATRIX + [[0, 0.5, 0], [0, 0, 0], [0, 0, 0]]}, "is not .fx 0 cx"),
    ([[0.1, 0.2, 0, 0]], {"camera_matrix": MATRIX * [[-1], [1], [1]]}, "not positive"),
    ([[0.1, 0.2, 0, 0]], {"camera_matrix": MATRIX[:2]}, "2 x 3"),
    ([[0.1, 0.2, 0, 0]], {"image_width": 640.5}, "image size"),
    ([[0.1, np.nan, 0, 0]], {}, "not finite"),
    ([[0.1, 0.2, 0, 0]], {"lens_model": "omni"}, "omni"),
    ([[0.1, 0.2, 0, 0]], {"lens_model": "brown5"}, "those of brown5"),
    ([[0.1, 0.2, 0, 0]], {"lens_model": "pinhole"}, "those of pinhole"),
    ([[0.1, 0.2, 0, 0]], {"parameter_covariance": np.eye(7)}, "7 x 7, not 8 x 8"),
    ([[0.1, 0.2, 0, 0]], {"parameter_covariance": -np.eye(8)}, "variances"),
])
def test_a_lens_that_we_cannot_hold_is_refused(tmp_path, distortion, more, complaint):
    path = tmp_path / "camera.yml"
    written_by_opencv(path, distortion, **more)
    with pytest.raises(BadInput, match=complaint) as caught:
        read("opencv_yaml", path)
    assert str(path) in str(caught.value) and caught.value.mend


def test_a_splined_model_of_mrcal_is_refused_with_the_way_out(tmp_path):
    path = tmp_path / "splined.cameramodel"
    path.write_text("{ 'lensmodel': 'LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=11_Ny=8_fov_x_deg=200',"
                    " 'intrinsics': [ 1, 2 ], 'imagersize': [ 640, 480 ] }")
    with pytest.raises(BadInput, match="SPLINED.*LENSMODEL_OPENCV8") as caught:
        read("mrcal_cameramodel", path)
    assert "mrcal-convert-lensmodel" in caught.value.mend


def test_an_import_is_a_measurement_that_says_where_it_came_from(tmp_path):
    path = tmp_path / "camera.yml"
    written_by_opencv(path, [[0.1, 0.2, 0, 0]])
    measurement = imported_lens(path, "opencv_yaml")
    assert measurement.name == "intrinsics" and measurement.intrinsics.fx_px == 533.1
    assert list(measurement.provenance.inputs) == ["camera.yml"]
    assert "imported from camera.yml (opencv_yaml)" in measurement.warnings[0] and "unknown" in measurement.warnings[1]
    with pytest.raises(UsageError, match="opencv_yaml"):
        imported_lens(path, "matlab")
