"""The compiled attitude of a frame against its plain form: projection with all derivatives, variances, covariance, chi^2."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.geometry import kernels as geometry_kernels
from calibench.geometry import projection, rotation
from calibench.records import Identification, Intrinsics
from calibench.stars import frame_attitude
from calibench.stars.attitude import kernels, quest
from calibench.stars.kernels import SURPRISE_SIGMA
from calibench.stars.per_lens import lens_terms

SIZE = (752, 480)
TERMS = {"pinhole": [], "brown4": [-0.37, 0.31, -1e-3, 3e-4], "brown5": [-0.37, 0.31, -1e-3, 3e-4, 0.1],
         "rational8": [-0.37, 0.31, -1e-3, 3e-4, 0.1, 0.02, 0.01, -0.03],
         "thin_prism12": [-0.37, 0.31, -1e-3, 3e-4, 0.1, 0.02, 0.01, -0.03, 1e-3, -2e-3, 5e-4, 1e-3],
         "fisheye4": [0.02, -0.01, 3e-3, -1e-3]}


def lens_of(model, *, skew=None, mirrored=False, seed=0):
    count = 4 + len(TERMS[model]) + (skew is not None)
    root = np.random.default_rng(seed).normal(size=(count, count)) * 1e-3
    return Intrinsics(model=model, fx_px=600.0, fy_px=605.0, cx_px=379.0, cy_px=236.0, distortion=TERMS[model],
                      image_size_px=SIZE, covariance=root @ root.T, mirrored=mirrored, skew_px=skew)


LENSES = [lens_of(model, skew=skew, mirrored=mirrored) for model in TERMS
          for skew, mirrored in ((None, False), (1.5, True))]


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: f"{lens.model}{'-skew-mirrored' if lens.mirrored else ''}")
def test_projection_and_its_derivatives(lens):
    v = np.random.default_rng(1).normal(size=(400, 3)) * [0.5, 0.4, 1.0]  # half of them behind the camera
    v[0] = 0, 0, 1
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    theirs = projection.project_with_jacobian(lens, v)
    ours = kernels.project(*lens_terms(lens), len(lens.distortion), v)
    seen = np.isfinite(theirs[0]).all(1)
    assert 50 < seen.sum() < 400
    for a, b in zip(theirs, ours, strict=True):
        b = b[..., :a.shape[2]] if a.ndim == 3 else b
        np.testing.assert_allclose(b[seen], a[seen], rtol=1e-12, atol=1e-12 * np.abs(a[seen]).max())
    assert np.isnan(ours[0][~seen]).all()
    on = ((ours[0] > 0) & (ours[0] < np.array(SIZE) - 1)).all(1)
    assert on.sum() > 40
    np.testing.assert_allclose(geometry_kernels.unproject(*lens_terms(lens), ours[0][on]), v[on], atol=1e-11)


def plain(found, calibrated):
    """Rotation, covariance and chi^2 of a frame in the formulas of frame_attitude.py."""
    lens = found.intrinsics
    v, by_xy = projection.unproject_with_jacobian(lens, found.xy_px)
    weight = frame_attitude.spot_weights(found, calibrated=calibrated)
    sigma2 = np.trace(by_xy @ np.linalg.inv(weight) @ np.swapaxes(by_xy, 1, 2), axis1=1, axis2=2) / 2
    matrix = quest.attitude(v, found.direction_icrs, 1 / sigma2)
    u = found.direction_icrs @ matrix.T
    xy, by_v, by_p = projection.project_with_jacobian(lens, u)
    residual, cross = found.xy_px - xy, rotation.skew(u)
    own = found.covariance_px2 if calibrated else np.linalg.inv(weight)
    a = 1 / sigma2[:, None, None]
    gain = np.linalg.inv((a * (np.eye(3) - u[:, :, None] * u[:, None, :])).sum(0))
    turned = a * (cross @ by_xy)
    covariance = gain @ np.einsum("mij,mjk,mlk->il", turned, own, turned) @ gain
    chi2_weight = np.linalg.inv(own + (by_p @ lens.covariance @ np.swapaxes(by_p, 1, 2) if calibrated else 0.0))
    jacobian = by_v @ -cross
    weighted = np.swapaxes(jacobian, 1, 2) @ chi2_weight
    gradient = np.einsum("mij,mj->i", weighted, residual)
    chi2 = np.einsum("mi,mij,mj->", residual, chi2_weight, residual) - gradient @ np.linalg.solve(
        (weighted @ jacobian).sum(0), gradient)
    return matrix, covariance, chi2, residual, weight


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("lens", LENSES[1::2], ids=lambda lens: lens.model)
def test_attitude_matches_its_plain_form(lens, calibrated):
    rng = np.random.default_rng(2)
    root = rng.normal(size=(30, 2, 2)) * 0.05 + np.eye(2) * 0.1
    xy, rows = rng.uniform(5, np.subtract(SIZE, 5), (30, 2)), np.arange(30)
    sky = projection.unproject(lens, xy) @ Rotation.random(random_state=3).as_matrix()
    found = Identification(status="solved", method="", spot_rows=rows, star_rows=rows, direction_icrs=sky, intrinsics=lens,
                           xy_px=xy + rng.normal(size=xy.shape) * 0.1, covariance_px2=root @ np.swapaxes(root, 1, 2))
    matrix, covariance, chi2, residual, weight = plain(found, calibrated)
    freedom = 2 * len(rows) - 3
    scale = chi2 / freedom if chi2 > freedom + SURPRISE_SIGMA * np.sqrt(2 * freedom) else 1.0
    attitude = frame_attitude.find_attitude(found, "quest", calibrated=calibrated)
    np.testing.assert_allclose(rotation.matrix_from_quaternion(attitude.q_cam_icrs), matrix, atol=1e-12)
    np.testing.assert_allclose(attitude.covariance_rad2, covariance * scale, rtol=1e-9, atol=1e-12 * np.abs(covariance).max())
    np.testing.assert_allclose(attitude.residual_px, residual, atol=1e-9)
    distance2 = kernels.misses2(attitude.residual_px, found.covariance_px2, frame_attitude.model_variance_px2(calibrated))
    np.testing.assert_allclose(distance2, np.einsum("mi,mij,mj->m", residual, weight, residual), rtol=1e-8)
