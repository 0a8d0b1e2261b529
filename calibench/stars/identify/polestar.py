"""Polestar (Silani and Lovera 2006): a star is known by its distances to the stars around it.

1. Table: distances in rings of width RING; each ring lists the stars (poles) that have a neighbour there.
2. A spot's neighbours each give one vote to all poles of the rings that their distance +- tolerance touches.
3. The poles of most votes are the spot's candidates; those of several spots must agree with each other (_votes.py).
Silani and Lovera take the best pole of each spot and check its companions; here a few are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..sky_catalogue import SkyCatalogue
from ..view import TOLERANCE_SIGMA, View, field_key
from . import _neighbourhoods, _votes

NEEDS_SCALE = True
table_key = field_key
RING = 1 / 200  # of the half diagonal
SPOTS = (12, 20)  # the brightest, then more where they led nowhere


class Table(NamedTuple):
    """pole (P,) star rows by ring; start (R + 1,) of each ring; width (1,) rad of a ring."""

    pole: np.ndarray
    start: np.ndarray
    width: np.ndarray


def build(sky: SkyCatalogue, key: float) -> Table:
    """The rings about the brightest stars of every circle of the field's size."""
    return table_of(_neighbourhoods.of_stars(sky, key), RING * min(key, np.pi / 2))


def table_of(stars: _neighbourhoods.Neighbourhoods, width_rad: float) -> Table:
    """Rings of that width."""
    ring = (stars.distance_rad / width_rad).astype(int)
    order = np.lexsort((stars.pole, ring))
    rings = int(ring.max(initial=0)) + 1
    start = np.searchsorted(ring[order], np.arange(rings + 1))
    return Table(pole=stars.pole[order].astype(np.int32), start=start.astype(np.int32), width=np.array([width_rad]))


def votes(view: View, table: Table, spots: _neighbourhoods.Neighbourhoods, stars: int) -> np.ndarray:
    """Votes (stars,) of one spot's neighbours."""
    error = (TOLERANCE_SIGMA * _neighbourhoods.pair_error(view.sigma_rad, spots)
             + (view.scale_slack + view.ratio_error) * spots.distance_rad)
    rings = len(table.start) - 1
    first = np.clip(((spots.distance_rad - error) / table.width).astype(int), 0, rings - 1)
    last = np.clip(((spots.distance_rad + error) / table.width).astype(int), 0, rings - 1)
    out = np.zeros(stars, np.int32)
    for low, high in zip(table.start[first], table.start[last + 1], strict=True):
        out[table.pole[low:high]] += 1  # once a neighbour, however many of the pole's fall into these rings
    return out


def propose(view: View, sky: SkyCatalogue, table: Table) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) spot rows, (B, 3) star rows."""
    radius = len(table.start) * float(table.width[0])
    for last in SPOTS:
        spots = _neighbourhoods.neighbourhoods(view.directions[:last], radius)
        poles = np.arange(min(last, len(view.directions)))
        stars = [_votes.most_voted(votes(view, table, spots.of(pole), len(sky.directions))) for pole in poles]
        yield from _votes.agreeing_triples(view, sky, np.repeat(poles, [len(s) for s in stars]), np.concatenate(stars))
        if last >= len(view.directions):
            return
