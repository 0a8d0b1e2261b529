"""StarPairs: all pairs of the brighter stars that fit in a field, sorted by their angle, searched by bisection.

Both orders of a pair are kept, so that a join over a common star needs no cases.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .sky_catalogue import SkyCatalogue

STARS_PER_FIELD = 22
MOST_PAIRS = 1_500_000


@dataclass(frozen=True, kw_only=True)
class StarPairs:
    """angle_rad (P,) ascending; first, second (P,) star rows."""

    angle_rad: np.ndarray
    first: np.ndarray
    second: np.ndarray
    brightest: int

    @classmethod
    def build(cls, sky: SkyCatalogue, half_diagonal_rad: float) -> StarPairs:
        """Pairs up to the field's diagonal among so many of the brightest stars that a field holds STARS_PER_FIELD."""
        field = 2 * np.pi * (1 - np.cos(half_diagonal_rad)) * 0.6
        brightest = int(min(len(sky.directions), STARS_PER_FIELD * 4 * np.pi / field))
        tree = cKDTree(sky.directions[:brightest])
        chord = 2 * np.sin(half_diagonal_rad)
        while tree.count_neighbors(tree, chord) > MOST_PAIRS:  # a very wide field: fewer stars serve
            brightest = int(0.8 * brightest)
            tree = cKDTree(sky.directions[:brightest])
        pairs = tree.query_pairs(chord, output_type="ndarray")
        a, b = np.concatenate([pairs, pairs[:, ::-1]]).T
        angle = 2 * np.arcsin(np.linalg.norm(sky.directions[a] - sky.directions[b], axis=1) / 2)
        order = np.argsort(angle, kind="stable")
        return cls(angle_rad=angle[order], first=a[order], second=b[order], brightest=brightest)

    def between(self, low_rad: float, high_rad: float) -> tuple[np.ndarray, np.ndarray]:
        """(first, second) star rows of all pairs whose angle lies in [low, high], both orders."""
        i, j = np.searchsorted(self.angle_rad, [low_rad, high_rad])
        return self.first[i:j], self.second[i:j]
