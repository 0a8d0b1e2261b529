"""Pyramid (Mortari et al. 2004): a triangle of inter-star angles, confirmed by a fourth star. Needs absolute angles.

1. Triples of the brightest spots in Mortari's order, which does not stick with one false spot.
2. Each side's angle +- tolerance gives a range of catalogue pairs; joining two sides on their common star and checking the
   third leaves the triangles of the sky that fit.
3. A fourth spot d confirms a triangle (a, b, c) when a star stands at all three angles from it.
The tolerance is propagated: TOLERANCE_SIGMA times the pair's sigma, plus the scale's slack times the angle.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...geometry import sphere
from .. import kernels
from ..sky_catalogue import SkyCatalogue
from ..star_pairs import StarPairs
from ..view import View, field_key, side_tolerance

NEEDS_SCALE = True
Table = StarPairs
table_key = field_key
TRIANGLE_SPOTS = 10
MOST_TRIANGLES = 20_000  # per triple: beyond it the triple says too little


def build(sky: SkyCatalogue, key: float) -> StarPairs:
    """All pairs that fit in such a field."""
    return StarPairs.build(sky, min(key, np.pi / 2))


def mortari_order(n: int) -> list[tuple[int, int, int]]:
    """Triples (i, i + dj, i + dj + dk), small steps last to change: a bad spot is left behind early."""
    return [(i, i + dj, i + dj + dk) for dj in range(1, n - 1) for dk in range(1, n - dj) for i in range(n - dj - dk)]


def triangles(view: View, sky: SkyCatalogue, pairs: StarPairs, triple: tuple[int, int, int]) -> np.ndarray:
    """(T, 3) star rows whose three angles fit those of a triple of spots."""
    a, b, c = triple
    angle = {(i, j): float(sphere.angle_between(view.directions[i], view.directions[j])) for i, j in ((a, b), (a, c), (b, c))}
    slack = {s: side_tolerance(view, *s, angle[s]) for s in angle}
    a1, b1 = pairs.between(angle[a, b] - slack[a, b], angle[a, b] + slack[a, b])
    a2, c2 = pairs.between(angle[a, c] - slack[a, c], angle[a, c] + slack[a, c])
    if not len(a1) or not len(a2):
        return np.zeros((0, 3), int)
    order = np.argsort(a2, kind="stable")
    start, stop = np.searchsorted(a2[order], a1, "left"), np.searchsorted(a2[order], a1, "right")
    count = stop - start
    if count.sum() > 50 * MOST_TRIANGLES:
        return np.zeros((0, 3), int)
    one = np.repeat(np.arange(len(a1)), count)
    two = order[np.repeat(start, count) + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)]
    third = 2 * np.arcsin(np.linalg.norm(sky.directions[b1[one]] - sky.directions[c2[two]], axis=1) / 2)
    fits = np.abs(third - angle[b, c]) < slack[b, c]
    return np.stack([a1[one[fits]], b1[one[fits]], c2[two[fits]]], -1)[:MOST_TRIANGLES]


def propose(view: View, sky: SkyCatalogue, table: StarPairs) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 4) spot rows, (B, 4) star rows: triangles with a confirming fourth star."""
    n = min(TRIANGLE_SPOTS, len(view.directions))
    for triple in mortari_order(n):
        found = triangles(view, sky, table, triple)
        others = [d for d in range(n) if d not in triple]
        if len(found) and others:
            spot_rows, star_rows = zip(*(_confirm(view, sky, triple, found, d) for d in others), strict=True)
            yield np.concatenate(spot_rows), np.concatenate(star_rows)


def _confirm(view: View, sky: SkyCatalogue, triple: tuple[int, int, int], found: np.ndarray,
             d: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles that have a star at the fourth spot's three angles: (B, 4) spot rows, (B, 4) star rows."""
    v = view.directions
    angle = np.array([np.arccos(np.clip(v[i] @ v[d], -1, 1)) for i in triple])
    slack = side_tolerance(view, np.array(triple), d, angle)
    # d's direction from the three corners: solve the 3x3 system u . star_i = cos(angle_i) for each triangle
    corners = sky.directions[found]
    solvable = np.abs(np.linalg.det(corners)) > 1e-9
    found, corners = found[solvable], corners[solvable]
    there = np.linalg.solve(corners, np.broadcast_to(np.cos(angle), (len(found), 3))[..., None])[..., 0]
    there /= np.maximum(np.linalg.norm(there, axis=1, keepdims=True), 1e-12)
    star = kernels.stars_near(sky.grid, there, float(10 * slack.max()))
    found, star = found[star >= 0], star[star >= 0]
    seen = 2 * np.arcsin(np.clip(np.linalg.norm(sky.directions[found] - sky.directions[star][:, None], axis=-1) / 2, 0, 1))
    fits = (np.abs(seen - angle) < slack).all(1) & (found != star[:, None]).all(1)
    star_rows = np.concatenate([found[fits], star[fits][:, None]], 1)
    return np.broadcast_to(np.array([*triple, d]), star_rows.shape), star_rows
