"""QUEST (Shuster and Oh 1981), with the sequential rotations that keep it away from half turns.

    alpha = l^2 - sigma^2 + tr adj S, gamma = alpha (l + sigma) - det S, x = (alpha I + (l - sigma) S + S^2) z
    q = (x, gamma) / norm, l the largest root of psi (`kernels.largest_root`)

gamma is proportional to the square of the quaternion's scalar part: at half turns it vanishes and x and gamma lose their
digits (the thesis loses 873 of 26437 exact cases so). Turning the sky by 180 deg about an axis first (sequential rotation)
leaves l unchanged and moves another component of the quaternion into the scalar's place: of the four frames (none, x, y, z)
the one with the largest gamma is used, and one of the four squares is always at least 1/4.
"""

from __future__ import annotations

import math

import numpy as np

from . import kernels
from ._davenport import (
    effective_weights,
    k_matrix,
    largest_root,
    matrix_of_papers_quaternion,
    profile_matrix,
    settled,
)

__all__ = ["attitude", "effective_weights"]


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    b = profile_matrix(camera, sky, weights)
    l = largest_root(b)
    flip = kernels.FLIPS[kernels.best_flip(l, b)]

    def quaternion_at(root: float) -> np.ndarray:
        q = kernels.quest_quaternion(root, b, flip)
        return q / math.sqrt(q @ q)
    return matrix_of_papers_quaternion(settled(k_matrix(b * flip), l, quaternion_at)) * flip
