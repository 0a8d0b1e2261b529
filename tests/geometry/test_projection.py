import dataclasses

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.geometry import projection
from calibench.records import DISTORTION_NAMES, Intrinsics

TERMS = [-0.3686, 0.3148, -0.0023, 0.0003, -0.05, 0.01, 0.02, -0.01, 0.001, -0.002, 0.0015, 0.003]
FISHEYE = [-0.02, 0.01, -0.004, 0.0005]


def lens(model: str, mirrored: bool = False) -> Intrinsics:
    n = len(DISTORTION_NAMES[model])
    terms = FISHEYE if model == "fisheye4" else TERMS[:n]
    return Intrinsics(model=model, fx_px=1416.7, fy_px=1420.1, cx_px=370.2, cy_px=244.9, distortion=terms,
                      image_size_px=(752, 480), covariance=np.eye(4 + n), mirrored=mirrored)


def skewed() -> Intrinsics:
    return dataclasses.replace(lens("rational8", mirrored=True), skew_px=2.5, covariance=np.eye(13))


def directions(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.stack([rng.uniform(-0.27, 0.27, n), rng.uniform(-0.17, 0.17, n), np.ones(n)], -1) * rng.uniform(0.5, 3, (n, 1))


@pytest.mark.parametrize("model", DISTORTION_NAMES)
def test_projection_is_opencvs(model):
    i, v = lens(model), directions()
    if model == "fisheye4":
        theirs = cv2.fisheye.projectPoints(v[:, None], np.zeros(3), np.zeros(3), i.camera_matrix, i.distortion)[0][:, 0]
    else:
        theirs = cv2.projectPoints(v, np.zeros(3), np.zeros(3), i.camera_matrix, i.distortion)[0][:, 0]
    np.testing.assert_allclose(projection.project(i, v), theirs, atol=1e-9)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("model", DISTORTION_NAMES)
def test_unprojection_inverts(model, mirrored):
    i, v = lens(model, mirrored), directions()
    unit = v / np.linalg.norm(v, axis=1, keepdims=True)
    np.testing.assert_allclose(projection.unproject(i, projection.project(i, v)), unit, atol=1e-12)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("model", DISTORTION_NAMES)
def test_jacobians_are_the_differences(model, mirrored):
    i, v = lens(model, mirrored), directions(20)
    xy, by_v, by_p = projection.project_with_jacobian(i, v)
    h = 1e-6
    for axis in range(3):
        step = np.eye(3)[axis] * h
        numeric = (projection.project(i, v + step) - projection.project(i, v - step)) / (2 * h)
        np.testing.assert_allclose(by_v[:, :, axis], numeric, rtol=1e-5, atol=1e-4)
    for p, _ in enumerate(i.parameter_names):
        def moved(sign, p=p):
            values = i.parameters.copy()
            values[p] += sign * h
            return Intrinsics(model=model, fx_px=values[0], fy_px=values[1], cx_px=values[2], cy_px=values[3],
                              distortion=values[4:], image_size_px=(752, 480), covariance=i.covariance, mirrored=mirrored)
        numeric = (projection.project(moved(1), v) - projection.project(moved(-1), v)) / (2 * h)
        np.testing.assert_allclose(by_p[:, :, p], numeric, rtol=1e-5, atol=1e-5)
    unit, by_xy = projection.unproject_with_jacobian(i, xy)
    for axis in range(2):
        step = np.eye(2)[axis] * 1e-3
        numeric = (projection.unproject(i, xy + step) - projection.unproject(i, xy - step)) / 2e-3
        np.testing.assert_allclose(by_xy[:, :, axis], numeric, rtol=1e-5, atol=1e-10)


def test_nothing_is_visible_behind_or_beyond_the_fold():
    i = lens("brown4")
    assert 0.5 < projection.fold_radius(i) < 2 or projection.fold_radius(i) == np.inf
    strong = Intrinsics(model="brown4", fx_px=500, fy_px=500, cx_px=320, cy_px=240, distortion=[-0.4, 0, 0, 0],
                        image_size_px=(640, 480), covariance=np.eye(8))
    assert projection.fold_radius(strong) == pytest.approx(np.sqrt(1 / 1.2))
    out = projection.project(strong, np.array([[0, 0, -1.0], [1.0, 0, 1], [0.5, 0, 1]]))
    assert np.isnan(out[:2]).all() and np.isfinite(out[2]).all()
    with pytest.raises(BadInput, match="folds"):
        projection.unproject(strong, np.array([[320 + 500 * 0.7, 240.0]]))


def test_a_fisheye_sees_past_ninety_degrees_up_to_its_fold():
    i = lens("fisheye4")
    angle = np.radians([0, 1e-7, 60, 90, 110])
    v = np.stack([np.sin(angle), np.zeros(5), np.cos(angle)], -1)
    xy, by_v, _ = projection.project_with_jacobian(i, v)
    assert (np.diff(xy[:, 0]) > 0).all() and np.isfinite(by_v).all()
    np.testing.assert_allclose(projection.unproject(i, xy), v, atol=1e-9)
    h = 1e-6
    for axis in range(3):
        step = np.eye(3)[axis] * h
        numeric = (projection.project(i, v + step) - projection.project(i, v - step)) / (2 * h)
        np.testing.assert_allclose(by_v[:, :, axis], numeric, rtol=1e-5, atol=2e-2)
    assert projection.fold_radius(i) == np.inf
    folded = Intrinsics(model="fisheye4", fx_px=300, fy_px=300, cx_px=320, cy_px=240, distortion=[-0.2, 0, 0, 0],
                        image_size_px=(640, 480), covariance=np.eye(8))
    fold = np.sqrt(1 / 0.6)  # of t - 0.2 t^3
    assert projection.fold_radius(folded) == pytest.approx(np.tan(fold))
    at = [[np.sin(t), 0, np.cos(t)] for t in (fold - 0.01, fold + 0.01)]
    assert np.isfinite(projection.project(folded, np.array(at))).tolist() == [[True, True], [False, False]]
    with pytest.raises(BadInput, match="cannot be inverted"):
        projection.unproject(folded, np.array([[320 + 300 * 0.9, 240.0]]))


def test_a_skew_slants_the_columns_inverts_and_has_its_derivative():
    i, v = skewed(), directions()
    straight = dataclasses.replace(i, skew_px=None, covariance=np.eye(12))
    at = projection.project(straight, v)
    slant = (at[:, 1] - i.cy_px) / i.fy_px * 2.5
    np.testing.assert_allclose(projection.project(i, v), at + np.column_stack([slant, 0 * slant]), atol=1e-9)
    unit = v / np.linalg.norm(v, axis=1, keepdims=True)
    np.testing.assert_allclose(projection.unproject(i, projection.project(i, v)), unit, atol=1e-12)
    _, by_v, by_parameters = projection.project_with_jacobian(i, v)
    assert i.parameter_names[-1] == "skew_px" and by_parameters.shape[2] == 13
    for k, p in enumerate(i.parameters):
        h = 1e-6 * max(1, abs(p)) * np.eye(13)[k]
        there, back = (projection.project(i.at(i.parameters + s * h), v) for s in (1, -1))
        np.testing.assert_allclose(by_parameters[:, :, k], (there - back) / (2 * h[k]), atol=1e-4)
    for k in range(3):
        h = 1e-6 * np.eye(3)[k]
        difference = (projection.project(i, v + h) - projection.project(i, v - h)) / 2e-6
        np.testing.assert_allclose(by_v[:, :, k], difference, atol=1e-3)
