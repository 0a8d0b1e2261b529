"""Vector angles (Liebe 1993): a star, the angles to two of its nearest neighbours, and the angle between them at the star.

Liebe takes the nearest two. One false or missing star among them would spoil a star's only feature, so here all pairs of its
nearest TABLE_NEIGHBOURS stars stand in the table, and all pairs of a spot's nearest NEIGHBOURS spots are asked.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from ...geometry import sphere
from ..circles import brightest_groups
from ..code_table import CodeTable
from ..sky_catalogue import SkyCatalogue
from ..view import View, field_key
from . import _features

NEEDS_SCALE = True
Table = CodeTable
table_key = field_key
STARS_PER_CIRCLE = 20
TABLE_NEIGHBOURS, NEIGHBOURS = 9, 4
SPOTS = (10, 16)  # among which neighbours are sought
CELL_SIDE, CELL_ANGLE_RAD = 1 / 80, 0.03  # of the half diagonal


def code(corners: np.ndarray) -> np.ndarray:
    """(..., 3, 3) -> (..., 3): angles from corner 0 to 1 and to 2, and the angle between them at corner 0, rad."""
    star, near, far = np.moveaxis(corners, -2, 0)
    a, b = np.cross(star, near), np.cross(star, far)
    between = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
    return np.stack([sphere.angle_between(star, near), sphere.angle_between(star, far), between], -1)


def neighbour_triples(directions: np.ndarray, neighbours: int) -> np.ndarray:
    """(T, 3) rows: a direction and two of its nearest neighbours, the nearer first."""
    nearest = cKDTree(directions).query(directions, k=min(neighbours + 1, len(directions)))[1]
    pairs = np.array(list(combinations(range(1, nearest.shape[1]), 2))).reshape(-1, 2)
    rows = np.concatenate([np.repeat(nearest[:, :1, None], len(pairs), 1), nearest[:, pairs]], -1)
    return rows.reshape(-1, 3)


def build(sky: SkyCatalogue, key: float) -> CodeTable:
    """The neighbourhoods of the brightest stars of every circle of the field's size."""
    stars = brightest_groups(sky, min(key, np.pi / 2), STARS_PER_CIRCLE, 1)[:, 0]
    rows = stars[neighbour_triples(sky.directions[stars], TABLE_NEIGHBOURS)]
    return CodeTable.of(code(sky.directions[rows]), rows, np.array([CELL_SIDE * key, CELL_SIDE * key, CELL_ANGLE_RAD]))


def propose(view: View, sky: SkyCatalogue, table: CodeTable) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) spot rows, (B, 3) star rows."""
    for last in SPOTS:
        corners = neighbour_triples(view.directions[:last], NEIGHBOURS)
        # Asked in both orders: where two neighbours are as far, noise may have changed which is the nearer.
        yield _features.lookup(view, table, code, np.concatenate([corners, corners[:, [0, 2, 1]]]))
        if last >= len(view.directions):
            break
