"""Covariance of the shared parameters: classical, clustered by view, and the one to recommend."""

from __future__ import annotations

import numpy as np

from .adjust import Solution

CHANCE_SIGMA = 2.0


def classical(solution: Solution) -> np.ndarray:
    """(S, S): sigma^2 (J'J)^-1 of lens and own parameters, poses included, sigma^2 from the residuals."""
    root = _root(solution.information.sum(axis=0))
    return solution.cost / solution.degrees_of_freedom * root @ root.T


def clustered(solution: Solution) -> np.ndarray:
    """(S, S): the sandwich over views with the small-sample correction CR2 (Bell and McCaffrey 2002, Survey Methodology 28).

    Unbiased when errors are independent, and it stays true when all points of a view err together.
    """
    root = _root(solution.information.sum(axis=0))
    weight, axes = np.linalg.eigh(root.T @ solution.information @ root)  # leverage of each view
    white = axes.swapaxes(1, 2) @ (solution.score @ root)[..., None] / np.sqrt(np.maximum(1 - weight, 1e-6))[..., None]
    white = (axes @ white)[..., 0] @ root.T
    return white.T @ white


def recommended(solution: Solution) -> np.ndarray:
    """(S, S): as far as the views err together the clustered covariance, for the rest the classical one.

    f, the clustered variance over the classical one as a mean over all parameters, says how far: of the variance in the
    data the share 1 - 1/f is common to the points of a view. An f within two standard errors, 2 (2 / (S V))^1/2, of 1 is
    chance, and the classical covariance stands. The clustered estimate alone would be as true on average, but of few views
    it is itself uncertain (a +-1 sigma interval of 13 views covers 64 %, not 68). With no more views than parameters only
    f is known, and the classical covariance is scaled by it.
    """
    of_points, of_views = classical(solution), clustered(solution)
    views, shared = solution.score.shape
    factor = float(np.trace(np.linalg.solve(of_points, of_views))) / shared
    if factor < 1 + CHANCE_SIGMA * np.sqrt(2 / (shared * views)):
        return of_points
    share = 1 - 1 / factor if views > shared else 0.0
    return share * of_views + (1 - share) * factor * of_points


def _root(information: np.ndarray) -> np.ndarray:
    """(S, S) with root @ root.T = information^-1; what rounding leaves open gets a huge variance, not a negative one."""
    scale = 1 / np.sqrt(np.diag(information))
    value, axes = np.linalg.eigh(information * np.outer(scale, scale))
    return scale[:, None] * axes / np.sqrt(np.maximum(value, len(value) * np.finfo(float).eps * value[-1]))
