"""The lens for other programs: what is written reads back there as the same numbers."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from calibench import registry
from calibench.errors import BadInput
from calibench.records import CalibrationMap, Camera, Intrinsics

SIZE = (752, 480)
DISTORTION = {"pinhole": [], "brown4": [-0.11, 0.2, 1e-4, -3e-7], "brown5": [-0.11, 0.2, 1e-4, -3e-7, 0.013],
              "rational8": [-0.11, 0.2, 1e-4, -3e-7, 0.013, 0.4, -0.01, 1 / 3]}


def map_with(model: str, **changes) -> CalibrationMap:
    n = len(DISTORTION[model])
    lens = Intrinsics(**{"model": model, "fx_px": 1416.7 + 1e-10, "fy_px": 1417.0, "cx_px": 375.5, "cy_px": 239.125,
                         "distortion": DISTORTION[model], "image_size_px": SIZE,
                         "covariance": 0.25 * np.eye(4 + n)} | changes)
    return CalibrationMap(image_size_px=SIZE, intrinsics=lens, measured=frozenset(["intrinsics"]),
                          camera=Camera(name="Bench cam #1"))


@pytest.mark.parametrize("model", DISTORTION)
def test_opencv_reads_the_same_doubles(tmp_path, model):
    calmap, path = map_with(model), tmp_path / "camera.yaml"
    registry.load("calibench.io.exports", "opencv_yaml").export(calmap, path)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("camera_matrix").mat(), calmap.intrinsics.camera_matrix)
    expected = DISTORTION[model] or [0.0] * 4
    np.testing.assert_array_equal(storage.getNode("distortion_coefficients").mat(), [expected])
    uncertainty = storage.getNode("parameter_uncertainty").mat()
    np.testing.assert_array_equal(uncertainty, [[0.5] * (4 + len(DISTORTION[model]))])
    assert (storage.getNode("image_width").real(), storage.getNode("image_height").real()) == SIZE
    storage.release()


def test_opencv_reads_an_unknown_uncertainty_as_infinity(tmp_path):
    path = tmp_path / "camera.yaml"
    calmap = map_with("pinhole", covariance=np.diag([1.0, 1.0, np.inf, np.inf]))
    registry.load("calibench.io.exports", "opencv_yaml").export(calmap, path)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(storage.getNode("parameter_uncertainty").mat(), [[1, 1, np.inf, np.inf]])
    storage.release()


def test_the_ros_text(tmp_path):
    path = tmp_path / "camera_info.yaml"
    registry.load("calibench.io.exports", "ros_camera_info").export(map_with("brown4", fx_px=1416.5), path)
    assert path.read_text() == """\
# pixel (0, 0) is the centre of the top-left pixel
# uncertainty (1 sigma): fx_px 0.5, fy_px 0.5, cx_px 0.5, cy_px 0.5, k1 0.5, k2 0.5, p1 0.5, p2 0.5
image_width: 752
image_height: 480
camera_name: Bench_cam_1
camera_matrix:
  rows: 3
  cols: 3
  data: [1416.5, 0.0, 375.5, 0.0, 1417.0, 239.125, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.11, 0.2, 0.0001, -3.0e-07, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [1416.5, 0.0, 375.5, 0.0, 0.0, 1417.0, 239.125, 0.0, 0.0, 0.0, 1.0, 0.0]
"""


def test_ros_names_the_rational_model(tmp_path):
    path = tmp_path / "camera_info.yaml"
    registry.load("calibench.io.exports", "ros_camera_info").export(map_with("rational8"), path)
    assert "distortion_model: rational_polynomial" in path.read_text() and "cols: 8" in path.read_text()


def test_the_kalibr_text(tmp_path):
    path = tmp_path / "camchain.yaml"
    registry.load("calibench.io.exports", "kalibr_camchain").export(map_with("brown4", fx_px=1416.5), path)
    assert path.read_text() == """\
# pixel (0, 0) is the centre of the top-left pixel
# uncertainty (1 sigma): fx_px 0.5, fy_px 0.5, cx_px 0.5, cy_px 0.5, k1 0.5, k2 0.5, p1 0.5, p2 0.5
cam0:
  camera_model: pinhole
  intrinsics: [1416.5, 1417.0, 375.5, 239.125]
  distortion_model: radtan
  distortion_coeffs: [-0.11, 0.2, 0.0001, -3.0e-07]
  resolution: [752, 480]
"""


def test_the_mrcal_text(tmp_path):
    path = tmp_path / "camera.cameramodel"
    unknown = np.diag([1.0, 1.0, np.inf, np.inf])
    calmap = map_with("pinhole", fx_px=1416.5, covariance=unknown)
    registry.load("calibench.io.exports", "mrcal_cameramodel").export(calmap, path)
    assert path.read_text() == """\
# pixel (0, 0) is the centre of the top-left pixel
# uncertainty (1 sigma): fx_px 1, fy_px 1, cx_px unknown, cy_px unknown
{
    'lensmodel':  'LENSMODEL_PINHOLE',
    # fx, fy, cx, cy, distortion
    'intrinsics': [ 1416.5, 1417.0, 375.5, 239.125 ],
    # rt_fromref
    'extrinsics': [ 0, 0, 0, 0, 0, 0 ],
    'imagersize': [ 752, 480 ],
}
"""


@pytest.mark.parametrize("model", ["pinhole", "brown4", "brown5"])
def test_the_star_tracker_json_holds_the_matrix_of_the_fit_and_all_keys_its_reader_takes(tmp_path, model):
    path, calmap = tmp_path / "camera.json", map_with(model)
    registry.load("calibench.io.exports", "cots_star_tracker_json").export(calmap, path)
    values, lens = json.loads(path.read_text()), calmap.intrinsics
    assert values["camera_matrix"] == lens.camera_matrix.tolist()
    assert [values[key] for key in ("fx", "fy", "up", "vp", "skew")] == [lens.fx_px, lens.fy_px, 375.5, 239.125, 0.0]
    expected = [*DISTORTION[model], *[0.0] * (5 - len(DISTORTION[model]))]
    assert [values[key] for key in ("k1", "k2", "p1", "p2", "k3")] == values["dist_coefs"][0] == expected
    assert values["resolution"] == [values["ncols"], values["nrows"]] == list(SIZE)
    assert values["uncertainty"]["fx_px"] == 0.5


def test_the_star_tracker_json_says_null_where_an_uncertainty_is_unknown(tmp_path):
    path = tmp_path / "camera.json"
    calmap = map_with("pinhole", covariance=np.diag([1.0, 1.0, np.inf, np.inf]))
    registry.load("calibench.io.exports", "cots_star_tracker_json").export(calmap, path)
    assert json.loads(path.read_text())["uncertainty"] == {"fx_px": 1.0, "fy_px": 1.0, "cx_px": None, "cy_px": None}


@pytest.mark.parametrize(("name", "model"), [("kalibr_camchain", "brown5"), ("kalibr_camchain", "rational8"),
                                             ("cots_star_tracker_json", "rational8")])
def test_a_model_that_the_format_has_not_is_refused(tmp_path, name, model):
    with pytest.raises(BadInput, match=f"cannot hold .* {model}") as caught:
        registry.load("calibench.io.exports", name).export(map_with(model), tmp_path / "out")
    assert "brown4" in caught.value.mend and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", registry.names("calibench.io.exports"))
@pytest.mark.parametrize("calmap", [CalibrationMap(image_size_px=SIZE), map_with("brown4", mirrored=True)],
                         ids=["unmeasured", "mirrored"])
def test_a_lens_that_cannot_be_exported_is_refused(tmp_path, name, calmap):
    with pytest.raises(BadInput, match="intrinsics"):
        registry.load("calibench.io.exports", name).export(calmap, tmp_path / "out.yaml")
    assert list(tmp_path.iterdir()) == []
