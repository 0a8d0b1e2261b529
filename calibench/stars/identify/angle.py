"""Pair angles (Gottlieb 1978): two spots are any two stars as far apart.

The simplest of all: a pair has a few hundred likenesses in the sky, in two orders each, and only the other spots tell which is
right. So it needs many spots; and its long search makes the odds of a coincidence worse, which the stated probability counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from ...geometry import sphere
from ..sky_catalogue import SkyCatalogue
from ..star_pairs import StarPairs
from ..view import View, side_tolerance
from . import pyramid

NEEDS_SCALE = True
Table = StarPairs
table_key = pyramid.table_key
build = pyramid.build
PAIR_SPOTS = 10


def propose(view: View, sky: SkyCatalogue, table: StarPairs) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 2) spot rows, (B, 2) star rows."""
    for i, j in sorted(combinations(range(min(PAIR_SPOTS, len(view.directions))), 2), key=sum):
        angle = float(sphere.angle_between(view.directions[i], view.directions[j]))
        error = side_tolerance(view, i, j, angle)
        stars = np.stack(table.between(angle - error, angle + error), -1)
        yield np.broadcast_to(np.array([i, j]), stars.shape), stars
