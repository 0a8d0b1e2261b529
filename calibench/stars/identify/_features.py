"""Triangles found again by any code of their corners: a file names the code, the rest is done here.

1. The catalogue's triangles are put in an order of corners and coded; the codes stand in a CodeTable.
2. A triple of spots is asked in each order that noise allows, with the tolerance of its code: numerical derivatives to
   every corner, TOLERANCE_SIGMA times their sigma, and what a scale off by scale_slack does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ..code_table import CodeTable
from ..sky_catalogue import SkyCatalogue
from ..view import TOLERANCE_SIGMA, View
from . import _triangles, kernels

Code = Callable[[np.ndarray], np.ndarray]  # (..., 3, 3) unit vectors of three corners -> (..., d)
STEP = 1e-6  # rad, of the numerical derivatives
SMALLEST_SIDE = 0.02  # of the longest: two spots this close blend or are one star
MOST_CELLS = 6  # across which a tolerance may reach: a code that is less sure says too little


def triangles(sky: SkyCatalogue, half_diagonal_rad: float) -> np.ndarray:
    """(G, 3) star rows, those of the default's table; the sides opposite the corners ascend."""
    groups = _triangles.groups_of(sky, half_diagonal_rad)
    return np.take_along_axis(groups, np.argsort(_triangles.sides(sky.directions[groups]), axis=1), 1)


def triples(view: View) -> Iterator[np.ndarray]:
    """(T, 3) spot rows in batches, the brightest first, in each order of ascending opposite sides that noise allows."""
    done, slack = 0, view.scale_slack + view.ratio_error
    for last in _triangles.WIDE_BATCHES:
        last = min(last, len(view.directions))
        if last > done:
            yield kernels.triangle_questions(view.directions, view.sigma_rad, slack, _triangles.triples(done, last))[2]
        done = last


def tolerance(view: View, corners: np.ndarray, code: Code) -> np.ndarray:
    """How far (T, d) the codes of spots of rows (T, 3) may be from the catalogue's."""
    v = view.directions[corners]
    base, variance = code(v), 0.0
    for corner in range(3):
        for axis in np.eye(3):
            moved = v.copy()
            moved[:, corner] += STEP * axis
            variance = variance + ((code(_unit(moved)) - base) / STEP * view.sigma_rad[corners[:, corner], None]) ** 2
    middle = v.mean(1, keepdims=True)
    stretch = np.abs(code(_unit(middle + (v - middle) * (1 + STEP))) - base) / STEP
    return TOLERANCE_SIGMA * np.sqrt(variance) + (view.scale_slack + view.ratio_error) * stretch


def lookup(view: View, table: CodeTable, code: Code, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Correspondences (B, 3) of the table's triangles to spots of rows (T, 3), by their code."""
    length = _triangles.sides(view.directions[corners])
    corners = corners[length.min(1, initial=np.inf) > SMALLEST_SIDE * length.max(1, initial=0)]
    error = tolerance(view, corners, code)
    telling = (error < MOST_CELLS * table.cell).all(1)
    owner, entry = table.near(code(view.directions[corners[telling]]), error[telling])
    return corners[telling][owner], table.rows[entry]


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
