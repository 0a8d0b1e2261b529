"""Compiled loops of the identifiers: what a frame's spots ask the tables."""

from __future__ import annotations

import numpy as np

from ...kernels import compiled
from ..kernels import TOLERANCE_SIGMA

ORDERS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


@compiled
def angle(a, b):
    """Angle between two unit vectors (3,); exact for small ones."""
    return 2 * np.arcsin(min(np.sqrt(((a - b) ** 2).sum()) / 2, 1.0))


@compiled
def triangle_questions(spots, sigma, slack, triples):
    """What triples (T, 3) of spots (N, 3), sigma (N,), ask a TriangleTable: codes (G, 3), tolerance (G, 3), corners (G, 3).

    Corners stand so that the sides opposite them ascend; where noise could have changed that order, each order is asked.
    """
    codes, tolerance = np.empty((6 * len(triples), 3)), np.empty((6 * len(triples), 3))
    corners = np.empty((6 * len(triples), 3), np.int64)
    side, error = np.empty(3), np.empty(3)
    asked = 0
    for triple in triples:
        for c in range(3):
            i, j = triple[(c + 1) % 3], triple[(c + 2) % 3]
            side[c] = angle(spots[i], spots[j])
            error[c] = TOLERANCE_SIGMA * np.sqrt(sigma[i] ** 2 + sigma[j] ** 2) + slack * side[c]
        for order in ORDERS:
            a, b, c = order
            if side[a] - side[b] < error[a] + error[b] and side[b] - side[c] < error[b] + error[c]:
                for d in range(3):
                    codes[asked, d], tolerance[asked, d] = side[order[d]], error[order[d]]
                    corners[asked, d] = triple[order[d]]
                asked += 1
    return codes[:asked], tolerance[:asked], corners[:asked]


@compiled
def ordered_quads(lengths, slack, rows, directions, permutations, permuted_sides, sides):
    """Four stars (B, 4) put in the order of four spots with six side lengths (B, 6), by the permutation whose sides fit best.

    slack (B,): by what factor the sizes may differ. Returns fits (B,) and the stars (B, 4) in order.
    """
    fits, out, theirs = np.zeros(len(rows), np.bool_), np.empty_like(rows), np.empty(6)
    for b in range(len(rows)):
        for k in range(6):
            theirs[k] = angle(directions[rows[b, sides[k, 0]]], directions[rows[b, sides[k, 1]]])
        ratio = theirs.max() / lengths[b].max()
        if not 1 / slack[b] < ratio < slack[b]:
            continue
        fits[b] = True
        scale, least = theirs.sum() / lengths[b].sum(), np.inf
        for p in range(len(permutations)):
            misfit = 0.0
            for k in range(6):
                misfit = max(misfit, abs(theirs[permuted_sides[p, k]] - lengths[b, k] * scale))
            if misfit < least:
                least = misfit
                for c in range(4):
                    out[b, c] = rows[b, permutations[p, c]]
    return fits, out
