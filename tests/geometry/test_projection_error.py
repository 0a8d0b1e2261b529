"""Uncertainty of directions: a turn of the camera is no error, and random lenses scatter as the covariance says."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibench.geometry import projection
from calibench.geometry.projection_error import direction_covariance, direction_jacobian
from calibench.records import Intrinsics

SIZE = (752, 480)
GRID = np.stack(np.meshgrid(np.linspace(0, 751, 12), np.linspace(0, 479, 8)), -1).reshape(-1, 2)


def lens(covariance: np.ndarray) -> Intrinsics:
    return Intrinsics(model="brown4", fx_px=1416.0, fy_px=1417.0, cx_px=370.0, cy_px=245.0, image_size_px=SIZE,
                      distortion=[-0.37, 0.31, -2e-3, 3e-4], covariance=covariance)


def test_directions_of_random_lenses_scatter_as_said():
    rng = np.random.default_rng(0)
    root = rng.normal(0, 1, (8, 8)) * np.array([0.3, 0.3, 1, 1, 1e-3, 5e-3, 1e-4, 1e-4])[:, None]
    truth = lens(root @ root.T)
    v = projection.unproject(truth, GRID)
    scatter = []
    for _ in range(2000):
        p = truth.parameters + root @ rng.normal(0, 1, 8)
        other = dataclasses.replace(truth, fx_px=p[0], fy_px=p[1], cx_px=p[2], cy_px=p[3], distortion=p[4:])
        seen = projection.unproject(other, GRID)
        u, _, wt = np.linalg.svd(v.T @ seen)
        scatter.append(seen @ (u @ np.diag([1, 1, np.linalg.det(u @ wt)]) @ wt).T - v)
    said = np.sqrt(np.trace(direction_covariance(truth, GRID), axis1=1, axis2=2))
    np.testing.assert_allclose(np.sqrt(np.mean(np.sum(np.square(scatter), -1), axis=0)), said, rtol=0.06)


def test_a_common_turn_is_taken_out_and_the_rest_stays_tangential():
    v, jacobian = direction_jacobian(lens(np.eye(8)), GRID)
    np.testing.assert_allclose(np.einsum("ni,nip->np", v, jacobian), 0, atol=1e-12)
    np.testing.assert_allclose(np.cross(v[:, None], jacobian.swapaxes(1, 2)).sum(axis=0), 0, atol=1e-9)
    # a shift of the principal point looks like a turn but for what is left in the corners
    whole = np.abs(projection.unproject_with_jacobian(lens(np.eye(8)), GRID)[1]).max()
    assert np.abs(jacobian[:, :, 2]).max() < 0.2 * whole
