"""TRIAD (Black 1964): the attitude of two directions, exact on the first. The other stars are not used.

First direction: the star of the largest weight; second: the one that tells most about the rotation around it, weight x sin^2.
"""

from __future__ import annotations

import numpy as np

from ._davenport import profile_matrix

FIRST_OVER_SECOND = 1e5  # in Wahba's problem, a weight that is as good as exact


def attitude(camera: np.ndarray, sky: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R_cam_icrs (3, 3) from unit vectors (N, 3), (N, 3) and weights (N,).

    Raises:
        BadInput: fewer than two directions, or all parallel.
    """
    profile_matrix(camera, sky, weights)
    pair = _pair(camera, weights)
    return _axes(camera[pair]) @ _axes(sky[pair]).T


def effective_weights(camera: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Wahba's weights with the same answer: nearly all on the first of the two, none on the others."""
    first, second = _pair(camera, weights)
    out = np.zeros(len(camera))
    out[first], out[second] = FIRST_OVER_SECOND, 1.0
    return out


def _pair(camera: np.ndarray, weights: np.ndarray) -> list[int]:
    first = int(np.argmax(weights))
    along = camera @ camera[first]
    return [first, int(np.argmax(weights * ((camera - along[:, None] * camera[first])**2).sum(1)))]


def _axes(v: np.ndarray) -> np.ndarray:
    """Columns: the first direction, the normal of both, and what completes them."""
    (a, b, c), (d, e, f) = v.tolist()
    normal = np.array([b * f - c * e, c * d - a * f, a * e - b * d])
    normal /= np.sqrt(normal @ normal)
    x, y, z = normal.tolist()
    return np.array([[a, x, b * z - c * y], [b, y, c * x - a * z], [c, z, a * y - b * x]])
