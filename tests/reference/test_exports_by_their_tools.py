"""Each exported lens, read and used by the program that it is for: the same directions fall on the same pixels.

OpenCV is at hand. mrcal and PyYAML (the YAML reader of Kalibr and of ROS's Python tools) are asked in the system's Python,
where Debian installs them (python3-mrcal, python3-yaml), and skipped where they are not. NASA's COTS-Star-Tracker takes the
keys of its JSON to cv2.undistortPoints, and so does the test.
"""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibench import registry
from calibench.calmap.compare_lens import lens_difference
from calibench.geometry import projection
from calibench.records import CalibrationMap, Intrinsics

SYSTEM_PYTHON = "/usr/bin/python3"
SIZE = (1280, 960)
DISTORTION = {"pinhole": [], "brown4": [-0.11, 0.08, 1e-3, -3e-7], "brown5": [-0.11, 0.08, 1e-3, -3e-7, 0.013],
              "rational8": [0.41, 0.03, 1e-3, -2e-4, 0.01, 0.7, 0.09, 1 / 700]}


def lens(model: str) -> Intrinsics:
    return Intrinsics(model=model, fx_px=1416.7 + 1e-10, fy_px=1419.25, cx_px=641.5, cy_px=477.125, image_size_px=SIZE,
                      distortion=DISTORTION[model], covariance=0.01 * np.eye(4 + len(DISTORTION[model])))


def exported(model: str, name: str, path: Path) -> Path:
    calmap = CalibrationMap(image_size_px=SIZE, intrinsics=lens(model), measured=frozenset(["intrinsics"]))
    registry.load("calibench.io.exports", name).export(calmap, path)
    return path


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """(N, 3) points in front of the camera, over the whole image and beyond."""
    rng = np.random.default_rng(7)
    return np.column_stack([rng.uniform(-0.5, 0.5, (500, 2)), np.ones(500)]) * rng.uniform(0.5, 9, (500, 1))


def by_opencv(camera_matrix, distortion, points: np.ndarray) -> np.ndarray:
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.asarray(camera_matrix, float),
                             np.asarray(distortion, float))[0][:, 0]


def asked(module: str, script: str, *arguments: object) -> object:
    """The JSON that a script prints in the system's Python, which has other modules than ours."""
    if not Path(SYSTEM_PYTHON).exists() or subprocess.run([SYSTEM_PYTHON, "-c", f"import {module}"],
                                                          capture_output=True).returncode:
        pytest.skip(f"{SYSTEM_PYTHON} has no {module} (apt-get install python3-{module})")
    done = subprocess.run([SYSTEM_PYTHON, "-c", script, *map(str, arguments)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("model", DISTORTION)
def test_opencv_projects_alike_from_its_yaml(tmp_path, points, model):
    path = exported(model, "opencv_yaml", tmp_path / "camera.yml")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    matrix, distortion = (storage.getNode(name).mat() for name in ("camera_matrix", "distortion_coefficients"))
    assert storage.getNode("lens_model").string() == model
    storage.release()
    np.testing.assert_allclose(by_opencv(matrix, distortion, points), projection.project(lens(model), points), atol=1e-9)


READ_YAML = "import json, sys, yaml; print(json.dumps(yaml.safe_load(open(sys.argv[1]))))"


@pytest.mark.parametrize("model", DISTORTION)
def test_ros_has_the_numbers_of_its_models(tmp_path, points, model):
    """REP 104: plumb_bob is (k1 k2 t1 t2 k3), rational_polynomial (k1 k2 t1 t2 k3 k4 k5 k6), both as OpenCV computes them."""
    values = asked("yaml", READ_YAML, exported(model, "ros_camera_info", tmp_path / "camera.yaml"))
    count = {"plumb_bob": 5, "rational_polynomial": 8}[values["distortion_model"]]
    assert values["distortion_coefficients"]["cols"] == len(values["distortion_coefficients"]["data"]) == count
    matrix = np.reshape(values["camera_matrix"]["data"], (3, 3))
    seen = by_opencv(matrix, values["distortion_coefficients"]["data"], points)
    np.testing.assert_allclose(seen, projection.project(lens(model), points), atol=1e-9)
    assert (values["image_width"], values["image_height"]) == SIZE
    np.testing.assert_array_equal(np.reshape(values["projection_matrix"]["data"], (3, 4))[:, :3], matrix)


@pytest.mark.parametrize(("model", "name"), [("pinhole", "none"), ("brown4", "radtan")])
def test_kalibr_has_the_fields_of_its_documented_format(tmp_path, points, model, name):
    """camera_model pinhole: intrinsics [fu fv pu pv]; radtan: [k1 k2 r1 r2], none: []; resolution [width, height]."""
    camera = asked("yaml", READ_YAML, exported(model, "kalibr_camchain", tmp_path / "camchain.yaml"))["cam0"]
    assert (camera["camera_model"], camera["distortion_model"], camera["resolution"]) == ("pinhole", name, list(SIZE))
    assert all(isinstance(value, float) for value in camera["intrinsics"] + camera["distortion_coeffs"])
    fu, fv, pu, pv = camera["intrinsics"]
    seen = by_opencv([[fu, 0, pu], [0, fv, pv], [0, 0, 1]], camera["distortion_coeffs"] or np.zeros(4), points)
    np.testing.assert_allclose(seen, projection.project(lens(model), points), atol=1e-9)


MRCAL = """
import json, sys, numpy, mrcal
model = mrcal.cameramodel(sys.argv[1])
points = numpy.array(json.loads(open(sys.argv[2]).read()))
print(json.dumps([model.intrinsics()[0], model.imagersize().tolist(), mrcal.project(points, *model.intrinsics()).tolist(),
                  model.extrinsics_rt_fromref().tolist()]))
"""


@pytest.mark.parametrize("model", DISTORTION)
def test_mrcal_loads_the_model_and_projects_alike(tmp_path, points, model):
    (tmp_path / "points.json").write_text(json.dumps(points.tolist()))
    path = exported(model, "mrcal_cameramodel", tmp_path / "camera.cameramodel")
    name, size, seen, pose = asked("mrcal", MRCAL, path, tmp_path / "points.json")
    assert (tuple(size), pose) == (SIZE, [0.0] * 6) and name.startswith("LENSMODEL_")
    np.testing.assert_allclose(seen, projection.project(lens(model), points), atol=1e-6)


MRCAL_WRITES = """
import json, sys, numpy, mrcal
lens, size = json.loads(sys.argv[2])
mrcal.cameramodel(intrinsics=(sys.argv[3], numpy.array(lens)), imagersize=size).write(sys.argv[1], note="a note")
print("null")
"""


@pytest.mark.parametrize(("model", "name"), [("pinhole", "LENSMODEL_PINHOLE"), ("brown4", "LENSMODEL_OPENCV4"),
                                             ("brown5", "LENSMODEL_OPENCV5"), ("rational8", "LENSMODEL_OPENCV8")])
def test_what_mrcal_writes_comes_in_to_its_ten_digits(tmp_path, model, name):
    path = tmp_path / "camera.cameramodel"
    asked("mrcal", MRCAL_WRITES, path, json.dumps([lens(model).parameters.tolist(), SIZE]), name)
    found = registry.load("calibench.io.imports", "mrcal_cameramodel").read(path)
    assert (found.model, found.image_size_px) == (model, SIZE)
    np.testing.assert_allclose(found.parameters, lens(model).parameters, rtol=1e-9)


MRCAL_DIFFERENCE = """
import json, sys, numpy, mrcal
a, b = map(mrcal.cameramodel, sys.argv[1:3])
_, shift, grid, turn = mrcal.projection_diff((a, b), gridn_width=30, use_uncertainties=False, focus_radius=1e5)
print(json.dumps([grid.tolist(), shift.tolist(), mrcal.r_from_R(turn[:3]).tolist()]))
"""


def test_mrcal_finds_the_same_difference_of_two_lenses(tmp_path):
    """mrcal fits the rotation to directions and we to pixels: nearly the same weights, and in pixels ours is the best."""
    a = lens("brown4")
    b = Intrinsics(model="brown4", fx_px=1419.0, fy_px=1420.0, cx_px=644.0, cy_px=476.0, image_size_px=SIZE,
                   distortion=[-0.108, 0.079, 9e-4, 1e-5], covariance=a.covariance)
    paths = []
    for name, one in (("a", a), ("b", b)):
        calmap = CalibrationMap(image_size_px=SIZE, intrinsics=one, measured=frozenset(["intrinsics"]))
        paths.append(tmp_path / f"{name}.cameramodel")
        registry.load("calibench.io.exports", "mrcal_cameramodel").export(calmap, paths[-1])
    grid, shift, turn_rad = (np.array(values) for values in asked("mrcal", MRCAL_DIFFERENCE, *paths))
    ours = lens_difference(a, b)
    np.testing.assert_allclose(grid.reshape(-1, 2), ours.xy_px)
    theirs_px = np.sqrt(np.mean(np.sum(shift**2, axis=-1)))
    assert ours.rms_px < theirs_px == pytest.approx(ours.rms_px, rel=0.02)
    np.testing.assert_allclose(turn_rad, ours.rotation_rad, atol=1e-4)


@pytest.mark.parametrize("model", ["pinhole", "brown4", "brown5"])
def test_cots_star_tracker_sees_the_same_directions(tmp_path, points, model):
    """Its main loop hands camera_matrix and coefficients built from these keys to cv2.undistortPoints."""
    values = json.loads(exported(model, "cots_star_tracker_json", tmp_path / "camera.json").read_text())
    matrix = np.array([[values["fx"], values["skew"], values["up"]], [0, values["fy"], values["vp"]], [0, 0, 1]])
    coefficients = np.array([values[key] for key in ("k1", "k2", "p1", "p2", "k3")])
    np.testing.assert_allclose(by_opencv(matrix, coefficients, points), projection.project(lens(model), points), atol=1e-9)
    xy = projection.project(lens(model), points)
    ideal = cv2.undistortPointsIter(xy[:, None], matrix, coefficients, np.eye(3), np.eye(3),
                                    (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12))[:, 0]
    np.testing.assert_allclose(ideal, points[:, :2] / points[:, 2:], atol=1e-9)
