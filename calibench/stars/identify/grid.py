"""Grid (Padgett and Kreutz-Delgado 1997): the stars around one fall into cells of a grid that is laid along a near neighbour.

1. Pattern: a star in the middle, the grid turned so that a neighbour beyond BUFFER lies on its first axis; the cells that
   hold stars.
2. Table: each cell lists the patterns that have a star there. A spot's pattern gives each listed pattern a vote.
3. The patterns of most votes are proposed: the star, the neighbour along which its grid lies, and the nearest two that voted;
   who brought a hypothesis about must stand in it, because the odds count every spot outside it as evidence.
Padgett takes the nearest neighbour. A false or missing star would turn the whole grid, so here each of the ALIGNED nearest
gives a pattern. A neighbour votes in all cells that its tolerance touches: its own noise, and that of the turn, which grows
with distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..sky_catalogue import SkyCatalogue
from ..view import TOLERANCE_SIGMA, View, field_key
from . import _neighbourhoods
from ._neighbourhoods import Neighbourhoods

NEEDS_SCALE = True
table_key = field_key
CELLS = 60  # across the pattern
BUFFER = 0.15  # of the pattern's radius: a nearer neighbour says too little about the turn
ALIGNED = 3
SPOTS = (12, 20)  # the brightest, then more where they led nowhere
MOST_PROPOSALS = 20  # of one pattern
FEWEST_VOTES = 2


class Table(NamedTuple):
    """pattern and star row in it (E,), by cell; start (CELLS^2 + 1,) of each cell; radius (1,) rad.

    pole, neighbour (Q,): star rows of each pattern.
    """

    pattern: np.ndarray
    star: np.ndarray
    start: np.ndarray
    pole: np.ndarray
    neighbour: np.ndarray
    radius: np.ndarray


def places(around: Neighbourhoods, axis: int, radius_rad: float) -> np.ndarray:
    """(2, P) of one star's neighbours, in cells from the grid's corner, the neighbour of row `axis` on the first axis."""
    turn = around.azimuth_rad - around.azimuth_rad[axis]
    return (around.distance_rad * np.stack([np.cos(turn), np.sin(turn)]) / radius_rad + 1) * CELLS / 2


def axes(around: Neighbourhoods, radius_rad: float) -> range:
    """Rows of the neighbours along which one star's grid is laid."""
    first = int(np.searchsorted(around.distance_rad, BUFFER * radius_rad))
    return range(first, min(first + ALIGNED, len(around.pole)))


def build(sky: SkyCatalogue, key: float) -> Table:
    """Patterns of the brightest stars of every circle of the field's size."""
    stars, radius = _neighbourhoods.of_stars(sky, key), _neighbourhoods.RADIUS * min(key, np.pi / 2)
    cell, pattern, member, pole, neighbour = *([np.zeros(0, int)] for _ in range(3)), [], []
    for star in np.unique(stars.pole):
        around = stars.of(star)
        for axis in axes(around, radius):
            x, y = places(around, axis, radius).astype(int).clip(0, CELLS - 1)
            cell.append(x * CELLS + y)
            pattern.append(np.full(len(x), len(pole)))
            member.append(around.neighbour)
            pole.append(star)
            neighbour.append(around.neighbour[axis])
    cell, pattern, member = np.concatenate(cell), np.concatenate(pattern), np.concatenate(member)
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(CELLS**2 + 1))
    return Table(pattern=pattern[order].astype(np.int32), star=member[order].astype(np.int32), start=start.astype(np.int32),
                 pole=np.array(pole, np.int32), neighbour=np.array(neighbour, np.int32), radius=np.array([radius]))


def votes(view: View, table: Table, around: Neighbourhoods, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Votes (V,) of one spot's neighbours, beside that on the axis: pattern, row of the neighbour, star row; sorted."""
    radius = float(table.radius[0])
    sigma = _neighbourhoods.pair_error(view.sigma_rad, around)
    error = (TOLERANCE_SIGMA * np.hypot(sigma, sigma[axis] * around.distance_rad / around.distance_rad[axis])
             + (view.scale_slack + view.ratio_error) * around.distance_rad) * CELLS / 2 / radius
    place = places(around, axis, radius)
    low, high = ((place + sign * error).astype(int).clip(0, CELLS - 1) for sign in (-1, 1))
    entries, voter = [np.zeros(0, int)], []
    for n in range(len(error)):
        for x in range(low[0, n], high[0, n] + 1) if n != axis else ():
            entries.append(np.arange(table.start[x * CELLS + low[1, n]], table.start[x * CELLS + high[1, n] + 1]))
            voter.append(np.full(len(entries[-1]), n))
    entries, voter = np.concatenate(entries), np.concatenate([np.zeros(0, int), *voter])
    entries, voter = (v[table.star[entries] != table.neighbour[table.pattern[entries]]] for v in (entries, voter))
    first = np.unique(table.pattern[entries] * np.int64(len(error)) + voter, return_index=True)[1]
    return table.pattern[entries[first]], voter[first], table.star[entries[first]]


def propose(view: View, sky: SkyCatalogue, table: Table) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 4) spot rows, (B, 4) star rows: a pattern's middle, the neighbour along which it lies, two voters."""
    radius = float(table.radius[0])
    for last in SPOTS:
        spots = _neighbourhoods.neighbourhoods(view.directions[:last], radius)
        for pole in range(min(last, len(view.directions))):
            around = spots.of(pole)
            for axis in axes(around, radius):
                pattern, voter, star = votes(view, table, around, axis)
                likely, start, count = np.unique(pattern, return_index=True, return_counts=True)
                order = np.argsort(-count, kind="stable")[:MOST_PROPOSALS]
                order = order[count[order] >= FEWEST_VOTES]
                likely, one, two = likely[order], start[order], start[order] + 1
                middle = np.broadcast_to(np.array([pole, around.neighbour[axis]]), (len(likely), 2))
                yield (np.column_stack([middle, around.neighbour[voter[one]], around.neighbour[voter[two]]]),
                       np.column_stack([table.pole[likely], table.neighbour[likely], star[one], star[two]]))
        if last >= len(view.directions):
            return
