"""Planar triangles by area and polar moment (COTS CMOS star imager, after Crassidis): the thesis's identifier, with tolerances.

For a triangle of unit vectors with sides a = |V1 - V2|, b = |V2 - V3|, c = |V3 - V1| and s = (a + b + c)/2:

    A = sqrt(s (s-a) (s-b) (s-c))          J = A (a^2 + b^2 + c^2) / 36

1. The catalogue's triangles: of the brightest stars in every circle of the field's size (stars/circles.py).
2. Triples of the brightest spots, A and J each with a tolerance propagated from the corners' covariance:
   dA = sum |dA/da| da and so on. (The thesis's fixed tolerance, far below the noise, fails from 0.04 % of a pixel on.)
3. Those within both tolerances are proposed, the corners put in order by their sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ..circles import brightest_groups
from ..sky_catalogue import SkyCatalogue
from ..view import TOLERANCE_SIGMA, View, field_key

NEEDS_SCALE = True
table_key = field_key
TRIANGLE_SPOTS = 9
STARS_PER_CIRCLE = 13  # the circle about a 4:3 frame: the frame itself holds some 8 of them
MOST_PROPOSALS = 200_000


class Table(NamedTuple):
    """rows (T, 3) star rows; area (T,) ascending; moment (T,)."""

    rows: np.ndarray
    area: np.ndarray
    moment: np.ndarray


def area_and_moment(sides: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 3) side lengths -> area and polar moment (...)."""
    s = sides.sum(-1) / 2
    area = np.sqrt(np.maximum(s * np.prod(s[..., None] - sides, axis=-1), 0))
    return area, area * (sides**2).sum(-1) / 36


def triangle_sides(corners: np.ndarray) -> np.ndarray:
    """(..., 3, 3) unit vectors V1 V2 V3 -> (..., 3) lengths |V1-V2|, |V2-V3|, |V3-V1|."""
    return np.linalg.norm(corners - np.roll(corners, -1, axis=-2), axis=-1)


def build(sky: SkyCatalogue, key: float) -> Table:
    """Triangles of the brightest stars of every circle the size of the field, no wider than its diagonal."""
    half = min(key, np.pi / 2)
    triangles = brightest_groups(sky, half, STARS_PER_CIRCLE, 3)
    return table_of(sky, triangles[triangle_sides(sky.directions[triangles]).max(1) < 2 * np.sin(half)])


def table_of(sky: SkyCatalogue, triangles: np.ndarray) -> Table:
    """The table of these triangles (T, 3) of star rows."""
    area, moment = area_and_moment(triangle_sides(sky.directions[triangles]))
    order = np.argsort(area)
    return Table(rows=triangles[order], area=area[order], moment=moment[order])


def tolerances(sides: np.ndarray, side_error: np.ndarray) -> tuple[float, float]:
    """Tolerance of A and J for sides (3,) each off by up to side_error (3,): first order, numerically differentiated."""
    step = 1e-6 * sides.max()
    base = np.array(area_and_moment(sides))
    slopes = np.array([np.array(area_and_moment(sides + step * axis)) - base for axis in np.eye(3)]) / step
    return tuple(np.sqrt(((slopes * side_error[:, None]) ** 2).sum(0)))


def within(view: View, corners: np.ndarray, table: Table) -> np.ndarray:
    """Rows of the table whose area and moment are those of three spots (rows (3,)), within the tolerances of both."""
    sides = triangle_sides(view.directions[corners])
    area, moment = area_and_moment(sides)
    pair_noise = np.hypot(view.sigma_rad[corners], view.sigma_rad[np.roll(corners, -1)])
    error_a, error_j = tolerances(sides, TOLERANCE_SIGMA * pair_noise + view.ratio_error * sides)
    error_a, error_j = error_a + 2 * view.scale_slack * area, error_j + 4 * view.scale_slack * moment
    i, j = np.searchsorted(table.area, [area - error_a, area + error_a])
    return np.arange(i, j)[np.abs(table.moment[i:j] - moment) < error_j]


def propose(view: View, sky: SkyCatalogue, table: Table) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) spot rows, (B, 3) star rows."""
    n = min(TRIANGLE_SPOTS, len(view.directions))
    for triple in sorted(combinations(range(n), 3), key=sum):
        corners = np.array(triple)
        near = within(view, corners, table)[:MOST_PROPOSALS]
        if len(near):
            stars = table.rows[near]
            # Order the stars' corners so that their sides ascend as the spots' do (side k joins corner k and k + 1).
            sides = triangle_sides(view.directions[corners])
            yield np.broadcast_to(_corner_order(sides[None], corners[None]), stars.shape), _corner_order(
                triangle_sides(sky.directions[stars]), stars)


def _corner_order(sides: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Corners (B, 3) sorted by the length of the side opposite each (side k + 1 is opposite corner k)."""
    opposite = np.roll(sides, -1, axis=-1)
    return np.take_along_axis(corners, np.argsort(opposite, axis=-1), axis=-1)
