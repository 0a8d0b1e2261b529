"""Four-star patterns by the ratios of their sides: the default, for a known lens as for an unknown one.

1. Groups of four of the brightest spots, brightest groups first, in growing batches.
2. Their five side ratios ask the PatternTable for the catalogue's patterns within tolerance.
3. The tolerance is propagated: centroid noise over the pattern's size, plus what an uncalibrated lens bends.
4. Corners are put in correspondence by comparing all six sides under the 24 permutations.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, permutations

import numpy as np

from ..patterns import SIDES, PatternTable, side_lengths, side_ratios
from ..sky_catalogue import SkyCatalogue
from ..view import TOLERANCE_SIGMA, View

NEEDS_SCALE = False
BATCH_SPOTS = (8, 11, 14)  # groups among the first 8 spots, then those that the next spots add
SMALLEST_SIDE = 0.02  # of the longest: two spots this close blend or are one star
LARGEST_TOLERANCE = 0.02

PERMUTATIONS = np.array(list(permutations(range(4))))
_SIDE_INDEX = {pair: i for i, pair in enumerate(map(tuple, SIDES))}
# Which of the six sides each side becomes under each permutation: (24, 6).
PERMUTED_SIDES = np.array([[_SIDE_INDEX[tuple(sorted((p[a], p[b])))] for a, b in SIDES] for p in PERMUTATIONS])


def table_key(view: View) -> tuple[float, float]:
    """The field range (full diagonal, rad) whose patterns this view needs, in steps of 25 % so that like views share one."""
    if not view.calibrated and view.scale_slack > 0.15:
        return 0.0, np.pi
    step = np.log(1.25)
    middle = np.round(np.log(2 * view.half_diagonal_rad) / step)
    return float(np.exp((middle - 1.5) * step)), float(np.exp((middle + 1.5) * step))


def build(sky: SkyCatalogue, key: tuple[float, float]) -> PatternTable:
    """The catalogue's patterns for that field range."""
    return PatternTable.build(sky, key)


def propose(view: View, sky: SkyCatalogue, table: PatternTable) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 4) spot rows, (B, 4) star rows, in batches."""
    done = 0
    for last in BATCH_SPOTS:
        last = min(last, len(view.directions))
        groups = np.array([g for g in combinations(range(last), 4) if g[3] >= done]).reshape(-1, 4)
        done = last
        if len(groups):
            yield _lookup(view, sky, table, groups)


def _lookup(view: View, sky: SkyCatalogue, table: PatternTable, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    lengths = side_lengths(view.directions[groups])
    longest, shortest = lengths.max(1), lengths.min(1)
    sigma = np.sqrt(2) * np.sqrt((view.sigma_rad[groups] ** 2).mean(1)) / longest
    tolerance = np.minimum(view.ratio_error + TOLERANCE_SIGMA * sigma, LARGEST_TOLERANCE)
    usable = shortest > SMALLEST_SIDE * longest
    groups, lengths, longest, tolerance = groups[usable], lengths[usable], longest[usable], tolerance[usable]
    found = table.tree.query_ball_point(side_ratios(lengths), tolerance, p=np.inf)
    owner = np.repeat(np.arange(len(groups)), [len(f) for f in found])
    patterns = np.concatenate([np.asarray(f, int) for f in found]) if len(owner) else np.zeros(0, int)
    slack = (1 + view.scale_slack) * (1 + tolerance[owner])
    ratio = table.longest_rad[patterns] / longest[owner]
    fits = (ratio < slack) & (ratio > 1 / slack)
    owner, patterns = owner[fits], patterns[fits]
    theirs = side_lengths(sky.directions[table.rows[patterns]])
    mine = lengths[owner] * (theirs.sum(1) / lengths[owner].sum(1))[:, None]
    misfit = np.abs(theirs[:, PERMUTED_SIDES] - mine[:, None, :]).max(-1)
    best = misfit.argmin(1)
    return groups[owner], np.take_along_axis(table.rows[patterns], PERMUTATIONS[best], axis=1)
