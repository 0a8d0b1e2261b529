"""Planar triangles (COTS CMOS star imager, after Diaz 2006): the longest side and two interior angles of three stars' chords.

Sides are |V1 - V2| and so on (the print takes differences of norms); interior angles by the law of cosines. The third angle
follows from the other two and is not compared.
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
CELL_SIDE, CELL_ANGLE_RAD = 1 / 80, 0.03  # of the half diagonal


def code(corners: np.ndarray) -> np.ndarray:
    """(..., 3, 3) -> (..., 3): the angles at corners 0 and 1, rad, and the chord opposite corner 2, the longest."""
    a, b, c = np.moveaxis(np.linalg.norm(np.roll(corners, -1, -2) - np.roll(corners, -2, -2), axis=-1), -1, 0)
    at_0 = np.arccos(np.clip((b**2 + c**2 - a**2) / (2 * b * c), -1, 1))
    at_1 = np.arccos(np.clip((a**2 + c**2 - b**2) / (2 * a * c), -1, 1))
    return np.stack([at_0, at_1, c], -1)


def build(sky: SkyCatalogue, key: float) -> CodeTable:
    """Triangles of the brightest stars of every circle the size of the field."""
    rows = _features.triangles(sky, key)
    return CodeTable.of(code(sky.directions[rows]), rows, np.array([CELL_ANGLE_RAD, CELL_ANGLE_RAD, CELL_SIDE * key]))


def propose(view: View, sky: SkyCatalogue, table: CodeTable) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) spot rows, (B, 3) star rows."""
    for corners in _features.triples(view):
        yield _features.lookup(view, table, code, corners)
