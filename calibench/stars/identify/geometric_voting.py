"""Geometric voting (Kolomenkin, Pollak, Shimshoni and Lindenbaum 2008): each pair of spots votes for all stars of its angle.

1. Every pair of spots as far apart as a pair of stars gives both stars a vote for both spots.
2. Each spot's stars of most votes are its candidates, and these vote for each other (_votes.py): there the right ones agree.
Kolomenkin et al. keep one star a spot; where stars are many the right one need not be first, so here a few are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from ...geometry import sphere
from ..sky_catalogue import SkyCatalogue
from ..star_pairs import StarPairs
from ..view import View, side_tolerance
from . import _votes, pyramid

NEEDS_SCALE = True
Table = StarPairs
table_key = pyramid.table_key
build = pyramid.build
SPOTS = (10, 16, 24)  # the brightest, then more where they led nowhere


def propose(view: View, sky: SkyCatalogue, table: StarPairs) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) spot rows, (B, 3) star rows."""
    votes = np.zeros((min(SPOTS[-1], len(view.directions)), len(sky.directions)), np.int32)
    done = 0
    for last in SPOTS:
        last = min(last, len(view.directions))
        if last == done:
            return
        for i, j in combinations(range(last), 2):
            if j >= done:
                angle = float(sphere.angle_between(view.directions[i], view.directions[j]))
                error = side_tolerance(view, i, j, angle)
                both_orders = table.between(angle - error, angle + error)[0]
                votes[i, both_orders] += 1  # a star of two such pairs has one vote of these spots
                votes[j, both_orders] += 1
        done = last
        stars = [_votes.most_voted(row) for row in votes[:last]]
        spot = np.repeat(np.arange(last), [len(s) for s in stars])
        yield from _votes.agreeing_triples(view, sky, spot, np.concatenate(stars))
