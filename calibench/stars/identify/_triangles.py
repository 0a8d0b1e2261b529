"""Triangles of the brightest stars of every circle of a field's size, found again by their three sides.

With a known lens three angles are enough: among some 1e5 triangles of the sky, hardly one has the sides of another.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations
from math import ceil, log, pi

import numpy as np

from ..circles import brightest_groups, unique_rows
from ..code_table import CodeTable
from ..sky_catalogue import SkyCatalogue
from ..view import CALIBRATED_MISFIT, View
from . import kernels

# Circles in parts of the half diagonal, and the stars taken of each. The large one gives long triangles; the small one reaches
# the corner of a frame that looks past a bright cluster.
CIRCLES = ((1.0, 9), (0.6, 9))
PARTS = (6, 4)  # of the image, the brightest spot of each of which is tried where the brightest of all led nowhere
KEY_STEP = 0.05  # of the half diagonal: like cameras share one table
CELL = 1 / 80  # of the half diagonal: some eight pixels, one or two triangles each
ABERRATION = 1e-4  # a table is of the sky at rest; the Earth's motion changes an angle by this part of it at most
BATCHES = (5, 7, 10, 14, 20)  # triples of the brightest spots first
WIDE_BATCHES = BATCHES[:4]  # through a lens that has drifted, where a question costs ten times as much


def sides(corners: np.ndarray) -> np.ndarray:
    """(..., 3, 3) unit vectors -> (..., 3) angles, rad, each opposite the corner of its place."""
    chord = np.linalg.norm(np.roll(corners, -1, -2) - np.roll(corners, -2, -2), axis=-1)
    return 2 * np.arcsin(np.clip(chord / 2, 0, 1))


def table_key(view: View) -> tuple[float]:
    """Half diagonal, rad, in steps of KEY_STEP, rounded up."""
    steps = ceil(log(min(view.half_diagonal_rad, pi / 2), 1 + KEY_STEP))
    return ((1 + KEY_STEP) ** steps,)


def groups_of(sky: SkyCatalogue, half_diagonal_rad: float) -> np.ndarray:
    """(G, 3) star rows of the table's triangles for such a field."""
    groups = [brightest_groups(sky, part * min(half_diagonal_rad, pi / 2), stars, 3) for part, stars in CIRCLES]
    return unique_rows(np.concatenate(groups), len(sky.directions))


def build(sky: SkyCatalogue, sizes: tuple[float]) -> CodeTable:
    """Codes: the three sides, ascending; rows: corners in the order of the sides opposite them."""
    return table_of(sky, groups_of(sky, sizes[0]), min(sizes[0], pi / 2))


def table_of(sky: SkyCatalogue, groups: np.ndarray, half: float) -> CodeTable:
    """The table of these groups (G, 3) of star rows, for a camera of this half diagonal, rad."""
    length = sides(sky.directions[groups])
    order = np.argsort(length, axis=1)
    length, groups = np.take_along_axis(length, order, 1), np.take_along_axis(groups, order, 1)
    fits = length[:, 2] < 2 * half
    return CodeTable.of(length[fits], groups[fits], np.full(3, CELL * half))


@lru_cache(maxsize=64)
def triples(done: int, last: int) -> np.ndarray:
    """(T, 3) rows of all triples among the first `last` spots that are not among the first `done`."""
    return np.array([t for t in combinations(range(last), 3) if t[2] >= done], np.int64).reshape(-1, 3)


def spread(view: View) -> np.ndarray:
    """Rows of the brightest spot in each part of the image: a Moon's glare or a tree is in some parts only."""
    w, h = view.intrinsics.image_size_px
    column, row = (np.clip(view.xy_px.T / [[w], [h]], 0, 0.999) * [[PARTS[0]], [PARTS[1]]]).astype(np.int64)
    return np.sort(np.unique(row * PARTS[0] + column, return_index=True)[1])


def propose(view: View, sky: SkyCatalogue, table: CodeTable) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) spot rows, (B, 3) star rows, in batches, the brightest spots' first."""
    done, slack = 0, view.scale_slack + ABERRATION

    def lookup(groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        codes, tolerance, corners = kernels.triangle_questions(view.directions, view.sigma_rad, slack, groups)
        owner, entry = table.near(codes, tolerance)
        return corners[owner], table.rows[entry]
    for last in BATCHES if view.scale_slack <= CALIBRATED_MISFIT else WIDE_BATCHES:
        last = min(last, len(view.directions))
        if last > done:
            yield lookup(triples(done, last))
        done = last
    if view.scale_slack <= CALIBRATED_MISFIT and len(view.directions) > done:
        rows = spread(view)
        yield lookup(rows[triples(0, len(rows))])
