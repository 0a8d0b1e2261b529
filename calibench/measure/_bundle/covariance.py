"""Covariance of the shared parameters: classical, and clustered by view."""

from __future__ import annotations

import numpy as np

from .adjust import Solution


def classical(solution: Solution) -> np.ndarray:
    """(S, S): sigma^2 (J'J)^-1 of lens and own parameters, poses included, sigma^2 from the residuals."""
    return solution.cost / solution.degrees_of_freedom * _inverse(solution.information.sum(axis=0))


def clustered(solution: Solution) -> np.ndarray:
    """(S, S): the sandwich over views with the small-sample correction CR2 (Bell and McCaffrey 2002, Survey Methodology 28).

    Unbiased when errors are independent, and it stays true when all points of a view err together.
    """
    total = _inverse(solution.information.sum(axis=0))
    scale = np.sqrt(np.diag(total))
    root = scale[:, None] * np.linalg.cholesky(total / np.outer(scale, scale))  # root @ root.T = total
    weight, axes = np.linalg.eigh(root.T @ solution.information @ root)  # leverage of each view
    white = axes.swapaxes(1, 2) @ (solution.score @ root)[..., None] / np.sqrt(np.maximum(1 - weight, 1e-6))[..., None]
    white = (axes @ white)[..., 0] @ root.T
    return white.T @ white


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a symmetric matrix whose parameters have very different units."""
    scale = 1 / np.sqrt(np.diag(matrix))
    return np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale)
