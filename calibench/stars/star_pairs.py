"""StarPairs: pairs of the brighter stars that fit in a field, sorted by their angle, searched by bisection.

Both orders of a pair are kept, so that a join over a common star needs no cases.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .circles import brightest_groups
from .sky_catalogue import SkyCatalogue

STARS_PER_CIRCLE = 24  # the circle about a 4:3 frame: the frame itself holds some 14 of them


class StarPairs(NamedTuple):
    """angle_rad (P,) ascending; first, second (P,) star rows."""

    angle_rad: np.ndarray
    first: np.ndarray
    second: np.ndarray

    @classmethod
    def build(cls, sky: SkyCatalogue, half_diagonal_rad: float) -> StarPairs:
        """Pairs of the brightest stars of every circle of the field's size."""
        pairs = brightest_groups(sky, half_diagonal_rad, STARS_PER_CIRCLE, 2)
        a, b = np.concatenate([pairs, pairs[:, ::-1]]).T
        angle = 2 * np.arcsin(np.linalg.norm(sky.directions[a] - sky.directions[b], axis=1) / 2)
        order = np.argsort(angle, kind="stable")
        return cls(angle_rad=angle[order], first=a[order], second=b[order])

    def between(self, low_rad: float, high_rad: float) -> tuple[np.ndarray, np.ndarray]:
        """(first, second) star rows of all pairs whose angle lies in [low, high], both orders."""
        i, j = np.searchsorted(self.angle_rad, [low_rad, high_rad])
        return self.first[i:j], self.second[i:j]
