"""From votes to proposals: what the identifiers that let stars vote for a spot share.

Each spot's stars of most votes are candidates. Two candidates agree where their stars are as far apart as their spots. Two that
agree are proposed with the third that agrees with both and with most others: whoever brought a hypothesis about must stand
in it, because the odds count every spot outside it as evidence.
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


def agreeing_triples(view: View, sky: SkyCatalogue, spot: np.ndarray,
                     star: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3) among candidates: spot rows (C,) that may be stars of rows (C,)."""
    i, j = np.triu_indices(len(spot), 1)
    apart = sphere.angle_between(view.directions[spot[i]], view.directions[spot[j]])
    off = np.abs(sphere.angle_between(sky.directions[star[i]], sky.directions[star[j]]) - apart)
    agree = (spot[i] != spot[j]) & (star[i] != star[j]) & (off < side_tolerance(view, spot[i], spot[j], apart))
    i, j = i[agree], j[agree]
    beside = np.zeros((len(spot), len(spot)), bool)
    beside[i, j] = beside[j, i] = True
    support = beside.sum(1)
    third = np.where(beside[i] & beside[j], support, 0)
    triples = np.stack([i, j, third.argmax(1)], -1)[third.any(1)] if len(i) else np.zeros((0, 3), int)
    triples = np.unique(np.sort(triples, axis=1), axis=0)
    triples = triples[np.argsort(-support[triples].sum(1), kind="stable")]
    for at in range(0, len(triples), BATCH):
        yield spot[triples[at:at + BATCH]], star[triples[at:at + BATCH]]
