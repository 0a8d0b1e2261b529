"""PatternTable: four-star patterns of the whole sky, searchable by the ratios of their sides, at every field size.

1. The sky is covered with circles of each radius in RADII_DEG (stars/circles.py).
2. In each circle the brightest STARS_PER_CIRCLE stars give all their groups of four; a group found twice is kept once.
3. A pattern is the five ratios of its sorted six sides to the longest, which neither scale, rotation nor mirror changes.
4. A k-d tree over the ratios answers: which patterns are within this tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from .circles import brightest_groups, unique_rows
from .sky_catalogue import SkyCatalogue

RADII_DEG = (2.2, 3.2, 4.6, 6.6, 9.5, 13.5, 19.0, 27.0)
STARS_PER_CIRCLE = 7
SIDES = np.array(list(combinations(range(4), 2)))


def side_lengths(corners: np.ndarray) -> np.ndarray:
    """(..., 4, 3) unit vectors -> (..., 6) angles, rad, in the order of SIDES."""
    chord = np.linalg.norm(corners[..., SIDES[:, 0], :] - corners[..., SIDES[:, 1], :], axis=-1)
    return 2 * np.arcsin(np.clip(chord / 2, 0, 1))


def side_ratios(lengths: np.ndarray) -> np.ndarray:
    """(..., 6) -> (..., 5): the five shorter sides over the longest, ascending."""
    ordered = np.sort(lengths, axis=-1)
    return ordered[..., :5] / ordered[..., 5:]


@dataclass(frozen=True, kw_only=True)
class PatternTable:
    """rows (Q, 4) star rows; ratios (Q, 5); longest_rad (Q,)."""

    rows: np.ndarray
    ratios: np.ndarray
    longest_rad: np.ndarray
    tree: cKDTree

    @classmethod
    def from_rows(cls, sky: SkyCatalogue, rows: np.ndarray) -> PatternTable:
        lengths = side_lengths(sky.directions[rows])
        ratios = side_ratios(lengths).astype(np.float32)
        return cls(rows=rows, ratios=ratios, longest_rad=lengths.max(-1),
                   tree=cKDTree(ratios, compact_nodes=False, balanced_tree=False))

    @classmethod
    def build(cls, sky: SkyCatalogue, fov_range_rad: tuple[float, float] = (0.0, np.pi)) -> PatternTable:
        """Patterns for cameras whose half diagonal may lie in fov_range_rad / 2 (default: every size of RADII_DEG)."""
        low, high = fov_range_rad[0] / 2, fov_range_rad[1] / 2
        radii = np.radians(RADII_DEG)
        wanted = radii[(radii > 0.45 * low) & (radii < 1.5 * high)]
        if not len(wanted):
            wanted = radii[[np.argmin(np.abs(radii - low))]]
        groups = np.concatenate([brightest_groups(sky, radius, STARS_PER_CIRCLE, 4) for radius in wanted])
        rows = unique_rows(groups, len(sky.directions))
        return cls.from_rows(sky, rows)
