"""Joint fit of attitude and lens to matched stars, where no map gave the lens: Gauss-Newton in pixels, with covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry import projection, rotation
from ..records import Intrinsics
from .guess.kernels import FIT_STEPS, HUBER_SIGMA, K1_FROM, K2_FROM, K_PRIOR_SD


def _lens_columns(free: int) -> list[list[int]]:
    """Which columns of d_xy_d_parameters make up each free lens term: common focal length, k1, k2."""
    return [[0, 1], [4], [5]][:free]


def refine(lens: Intrinsics, start: np.ndarray, xy_px: np.ndarray, covariance_px2: np.ndarray, directions: np.ndarray,
           model_sd_px: float) -> Intrinsics:
    """The lens, with covariance, that fits together with an attitude to matched spots (M, 2) with covariance (M, 2, 2) and star
    directions (M, 3), from a brown4 lens and a rotation.

    Focal length, and k1 and k2 as the number of matches allows, are free. model_sd_px: what the lens model itself may be off,
    added to every spot.
    """
    m = len(xy_px)
    free = 1 + (m >= K1_FROM) + (m >= K2_FROM)
    matrix = start
    weight = np.linalg.inv(covariance_px2 + np.eye(2) * model_sd_px**2)
    columns = _lens_columns(free)
    prior = np.zeros(3 + free)
    prior[4:] = 1 / K_PRIOR_SD**2
    for _ in range(FIT_STEPS):
        v = directions @ matrix.T
        xy, by_v, by_p = projection.project_with_jacobian(lens, v)
        residual = xy_px - xy
        seen = np.isfinite(residual).all(1)
        jacobian = np.concatenate([by_v @ -rotation.skew(v), *(by_p[..., c].sum(-1, keepdims=True) for c in columns)], -1)
        residual, jacobian = np.where(seen[:, None], residual, 0), np.where(seen[:, None, None], jacobian, 0)
        size = np.sqrt(np.einsum("mi,mij,mj->m", residual, weight, residual))
        robust = weight * np.minimum(1, HUBER_SIGMA / np.maximum(size, 1e-9))[:, None, None]
        transposed = np.swapaxes(jacobian, 1, 2) @ robust
        normal = (transposed @ jacobian).sum(0) + np.diag(prior)
        gradient = (transposed @ residual[..., None]).sum(0)[:, 0]
        terms = np.array([lens.fx_px, *lens.distortion[:2]])[:free]
        gradient[4:] -= prior[4:] * terms[1:]
        step = np.linalg.solve(normal, gradient)
        matrix = rotation.matrix_from_rotvec(step[:3]) @ matrix
        terms = terms + step[3:]
        focal = max(terms[0], 0.1 * lens.fx_px)
        lens = replace(lens, fx_px=focal, fy_px=focal, distortion=np.concatenate([terms[1:], lens.distortion[free - 1:]]))
    return replace(lens, covariance=_lens_covariance(lens, np.linalg.inv(normal)[3:, 3:]))


def _lens_covariance(lens: Intrinsics, fitted: np.ndarray) -> np.ndarray:
    """Covariance over all lens parameters: what was fitted, infinite for the principal point, which one frame cannot see."""
    spread = np.zeros((len(lens.parameters), len(fitted)))
    for term, columns in enumerate(_lens_columns(len(fitted))):
        spread[columns, term] = 1
    full = spread @ fitted @ spread.T
    full[2, 2] = full[3, 3] = np.inf
    return full
