"""Four-star patterns of the whole sky, found again by the ratios of their sides, at every field size.

1. The sky is covered with circles of each radius in RADII_DEG (stars/circles.py).
2. In each circle the brightest STARS_PER_CIRCLE stars give all their groups of four; a group found twice is kept once.
3. A pattern's code is the five ratios of its sorted six sides to the longest, which neither scale, rotation nor mirror
   changes, so that one table serves a lens of which nothing is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import combinations, permutations

import numpy as np

from ..circles import brightest_groups, unique_rows
from ..code_table import CodeTable
from ..sky_catalogue import SkyCatalogue
from ..view import TOLERANCE_SIGMA, View
from . import kernels

RADII_DEG = (2.2, 3.2, 4.6, 6.6, 9.5, 13.5, 19.0, 27.0)
STARS_PER_CIRCLE = 7
BATCHES = (8, 11, 14)  # groups among the first 8 spots, then those that the next spots add
SMALLEST_SIDE = 0.02  # of the longest: two spots this close blend or are one star
LARGEST_TOLERANCE = 0.02
CELL = 0.035
SIDES = np.array(list(combinations(range(4), 2)))
PERMUTATIONS = np.array(list(permutations(range(4))))
_SIDE_INDEX = {pair: i for i, pair in enumerate(map(tuple, SIDES))}
# Which of the six sides each side becomes under each permutation: (24, 6).
PERMUTED_SIDES = np.array([[_SIDE_INDEX[tuple(sorted((p[a], p[b])))] for a, b in SIDES] for p in PERMUTATIONS])


def side_lengths(corners: np.ndarray) -> np.ndarray:
    """(..., 4, 3) unit vectors -> (..., 6) angles, rad, in the order of SIDES."""
    chord = np.linalg.norm(corners[..., SIDES[:, 0], :] - corners[..., SIDES[:, 1], :], axis=-1)
    return 2 * np.arcsin(np.clip(chord / 2, 0, 1))


def side_ratios(lengths: np.ndarray) -> np.ndarray:
    """(..., 6) -> (..., 5): the five shorter sides over the longest, ascending."""
    ordered = np.sort(lengths, axis=-1)
    return ordered[..., :5] / ordered[..., 5:]


def table_key(view: View) -> tuple[float, ...]:
    """Which of RADII_DEG hold the patterns of the fields that this guess allows."""
    slack = 1 + view.scale_slack
    low, high = view.half_diagonal_rad / slack, view.half_diagonal_rad * slack
    wanted = tuple(radius for radius in RADII_DEG if 0.4 * low < np.radians(radius) < 1.3 * high)
    return wanted or (min(RADII_DEG, key=lambda radius: abs(np.radians(radius) - low)),)


def build(sky: SkyCatalogue, radii_deg: tuple[float, ...]) -> CodeTable:
    """Patterns in circles of these radii; codes: side ratios; rows: the four stars."""
    groups = np.concatenate([brightest_groups(sky, np.radians(radius), STARS_PER_CIRCLE, 4) for radius in radii_deg])
    rows = unique_rows(groups, len(sky.directions))
    return CodeTable.of(side_ratios(side_lengths(sky.directions[rows])), rows, np.full(5, CELL))


@lru_cache(maxsize=64)
def _groups(done: int, last: int) -> np.ndarray:
    """(G, 4) rows of all groups of four among the first `last` spots that are not among the first `done`."""
    return np.array([g for g in combinations(range(last), 4) if g[3] >= done], np.int64).reshape(-1, 4)


def propose(view: View, sky: SkyCatalogue, table: CodeTable) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 4) spot rows, (B, 4) star rows, in batches, the brightest spots' groups first.

    The tolerance of a ratio is propagated: centroid noise over the pattern's size, plus what an unknown lens bends.
    """
    done = 0
    for last in BATCHES:
        last = min(last, len(view.directions))
        groups, done = _groups(done, last), last
        lengths = side_lengths(view.directions[groups])
        longest = lengths.max(1, initial=0)
        usable = lengths.min(1, initial=np.inf) > SMALLEST_SIDE * longest
        groups, lengths, longest = groups[usable], lengths[usable], longest[usable]
        sigma = np.sqrt(2 * (view.sigma_rad[groups] ** 2).mean(1)) / longest
        tolerance = np.minimum(view.ratio_error + TOLERANCE_SIGMA * sigma, LARGEST_TOLERANCE)
        owner, entry = table.near(side_ratios(lengths), np.repeat(tolerance[:, None], 5, axis=1))
        slack = (1 + view.scale_slack) * (1 + tolerance)
        fits, stars = kernels.ordered_quads(lengths[owner], slack[owner], table.rows[entry], sky.directions, PERMUTATIONS,
                                            PERMUTED_SIDES, SIDES)
        yield groups[owner[fits]], stars[fits]
