"""Oriented triangles (Rousseau, Bostel and Mazari 2005): three sides in the order in which the corners turn.

The first side is the longest, the next follow counter-clockwise: a triangle and its mirror image have different codes,
which leaves half of the candidates that the sides alone would have. Rousseau et al. quantise the sides; here they have
propagated tolerances.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..code_table import CodeTable
from ..sky_catalogue import SkyCatalogue
from ..view import View, field_key
from . import _features, _triangles

NEEDS_SCALE = True
Table = CodeTable
table_key = field_key
code = _triangles.sides
CELL = 1 / 80  # of the half diagonal


def turning(directions: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Rows (T, 3) with ascending opposite sides -> the corner opposite the longest first, the others counter-clockwise."""
    corners = corners[:, [2, 0, 1]]
    clockwise = np.linalg.det(directions[corners]) < 0
    return np.where(clockwise[:, None], corners[:, [0, 2, 1]], corners)


def build(sky: SkyCatalogue, key: float) -> CodeTable:
    """Triangles of the brightest stars of every circle the size of the field."""
    rows = turning(sky.directions, _features.triangles(sky, key))
    return CodeTable.of(code(sky.directions[rows]), rows, np.full(3, CELL * key))


def propose(view: View, sky: SkyCatalogue, table: CodeTable) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) spot rows, (B, 3) star rows."""
    for corners in _features.triples(view):
        # Orders that differ only in the shorter sides turn into one.
        yield _features.lookup(view, table, code, np.unique(turning(view.directions, corners), axis=0))
