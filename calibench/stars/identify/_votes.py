"""From votes to proposals: what the identifiers that let stars vote for a spot share.

Each spot's stars of most votes are candidates. Two candidates agree where their stars are as far apart as their spots;
those that agree with most others are proposed first, as pairs.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...geometry import sphere
from ..sky_catalogue import SkyCatalogue
from ..view import View, side_tolerance

CANDIDATES = 12  # stars of most votes, of each spot
FEWEST_VOTES = 2
BATCH = 50


def most_voted(votes: np.ndarray) -> np.ndarray:
    """Rows (K,), at most CANDIDATES, of the most votes (S,), at least FEWEST_VOTES."""
    rows = np.flatnonzero(votes >= FEWEST_VOTES)
    return rows[np.argsort(-votes[rows], kind="stable")[:CANDIDATES]]


def agreeing_pairs(view: View, sky: SkyCatalogue, spot: np.ndarray,
                   star: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 2) among candidates: spot rows (C,) that may be stars of rows (C,)."""
    i, j = np.triu_indices(len(spot), 1)
    apart = sphere.angle_between(view.directions[spot[i]], view.directions[spot[j]])
    off = np.abs(sphere.angle_between(sky.directions[star[i]], sky.directions[star[j]]) - apart)
    agree = (spot[i] != spot[j]) & (star[i] != star[j]) & (off < side_tolerance(view, spot[i], spot[j], apart))
    i, j = i[agree], j[agree]
    support = np.bincount(np.concatenate([i, j]), minlength=len(spot))
    order = np.argsort(-(support[i] + support[j]), kind="stable")
    pairs = np.stack([i, j], -1)[order]
    for at in range(0, len(pairs), BATCH):
        yield spot[pairs[at:at + BATCH]], star[pairs[at:at + BATCH]]
