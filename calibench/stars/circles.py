"""Circles over the whole sky and the brightest stars in each: how a table of patterns stays even in rich and poor fields.

A cut in magnitude gives the Milky Way hundreds of stars a field and the galactic pole three; the brightest few of every
circle are what a camera pointed there sees first.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from ..errors import BadInput
from .sky_catalogue import SkyCatalogue

SPACING = 0.7  # between centres, in radii: any field lies well inside some circle
CLOSEST_FRACTION = 0.04  # of the radius: two stars closer than this are one spot to a camera of that field
THINNING = 8  # stars kept a circle, in multiples of those wanted, before the poorest fields would notice


def fibonacci_sphere(count: int) -> np.ndarray:
    """(count, 3) evenly spread directions."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


def brightest_groups(sky: SkyCatalogue, radius_rad: float, stars: int, size: int) -> np.ndarray:
    """(G, size) star rows, ascending: all groups of `size` among the brightest `stars` of every circle, each group once."""
    kept = min(len(sky.directions), int(THINNING * stars * 2 / (1 - np.cos(radius_rad))))
    tree = cKDTree(sky.directions[:kept])
    close = tree.query_pairs(CLOSEST_FRACTION * radius_rad, output_type="ndarray")
    alone = np.ones(kept, bool)
    alone[close.max(1)] = False  # rows are sorted by brightness: the fainter of a close pair goes
    rows = np.flatnonzero(alone)
    centres = fibonacci_sphere(int(4 * np.pi / (SPACING * radius_rad) ** 2))
    members = cKDTree(sky.directions[rows]).query_ball_point(centres, 2 * np.sin(radius_rad / 2), return_sorted=True)
    circles = {tuple(rows[m[:stars]]) for m in members if len(m) >= size}
    groups = [np.zeros((0, size), np.int64)]
    for count in {len(circle) for circle in circles}:
        alike = np.array([circle for circle in circles if len(circle) == count])
        groups.append(alike[:, list(combinations(range(count), size))].reshape(-1, size))
    return unique_rows(np.concatenate(groups), len(sky.directions))


def unique_rows(groups: np.ndarray, base: int) -> np.ndarray:
    """Rows (G, size) of ascending numbers below `base`, each once, sorted.

    Raises:
        BadInput: a row does not fit into one 64-bit key.
    """
    if base ** groups.shape[1] > np.iinfo(np.int64).max:
        raise BadInput(f"a star table of {base} stars is too large for groups of {groups.shape[1]}",
                       mend="cut the table at a brighter magnitude")
    weight = base ** np.arange(groups.shape[1])[::-1].astype(np.int64)
    keys = np.unique(groups.astype(np.int64) @ weight)
    return (keys[:, None] // weight % base).astype(np.int32)
