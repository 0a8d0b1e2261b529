"""Spherical triangles by area and polar moment (Cole and Crassidis 2006).

    A = the triangle's solid angle          J = integral over it of theta^2, theta the angle from its centroid

Cole and Crassidis divide the triangle into smaller and smaller ones to sum J. Here it is a quadrature of fifth order over
the plane of the three unit vectors, at distance h from the origin, where a piece dS at point p fills the solid angle h dS /
|p|^3. The roots sqrt(A) and J^(1/4) are compared: both are lengths, and evenly spread over the table.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..code_table import CodeTable
from ..sky_catalogue import SkyCatalogue
from ..view import View, field_key
from . import _features

NEEDS_SCALE = True
Table = CodeTable
table_key = field_key
CELL = 1 / 400  # of the half diagonal
# Radon's seven points of a triangle, in barycentric coordinates, and their weights (exact to the fifth order).
_NEAR, _FAR = (6 - 15**0.5) / 21, (6 + 15**0.5) / 21
POINTS = np.array([[1 / 3] * 3, *(np.roll([1 - 2 * a, a, a], k) for a in (_NEAR, _FAR) for k in range(3))])
WEIGHTS = np.array([9 / 40, *[(155 - 15**0.5) / 1200] * 3, *[(155 + 15**0.5) / 1200] * 3])


def area_and_moment(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 3, 3) unit vectors -> solid angle (...) sr and polar moment (...) rad^4."""
    a, b, c = np.moveaxis(corners, -2, 0)
    triple = np.abs((a * np.cross(b, c)).sum(-1))
    area = 2 * np.arctan2(triple, 1 + (a * b).sum(-1) + (b * c).sum(-1) + (c * a).sum(-1))
    p = POINTS @ corners
    size = np.linalg.norm(p, axis=-1)
    piece = WEIGHTS / size**3
    piece *= (area / piece.sum(-1))[..., None]
    centre = (piece[..., None] * p / size[..., None]).sum(-2)
    centre /= np.maximum(np.linalg.norm(centre, axis=-1, keepdims=True), np.finfo(float).tiny)  # no area, no moment
    theta = 2 * np.arcsin(np.clip(np.linalg.norm(p / size[..., None] - centre[..., None, :], axis=-1) / 2, 0, 1))
    return area, (piece * theta**2).sum(-1)


def code(corners: np.ndarray) -> np.ndarray:
    """(..., 3, 3) -> (..., 2): sqrt(A) and J^(1/4), rad."""
    area, moment = area_and_moment(corners)
    return np.stack([np.sqrt(area), moment**0.25], -1)


def build(sky: SkyCatalogue, key: float) -> CodeTable:
    """Triangles of the brightest stars of every circle the size of the field."""
    rows = _features.triangles(sky, key)
    return CodeTable.of(code(sky.directions[rows]), rows, np.full(2, CELL * key))


def propose(view: View, sky: SkyCatalogue, table: CodeTable) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) spot rows, (B, 3) star rows; the corners stand in the order of their opposite sides."""
    for corners in _features.triples(view):
        yield _features.lookup(view, table, code, corners)
