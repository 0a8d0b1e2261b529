"""PatternTable: four-star patterns of the whole sky, searchable by the ratios of their sides, at every field size.

1. The sky is covered with circles of radii from RADII_DEG, centres on a Fibonacci lattice 0.7 radius apart.
2. In each circle the brightest STARS_PER_CIRCLE stars give all their groups of four; a group found twice is kept once.
3. A pattern is the five ratios of its sorted six sides to the longest, which neither scale, rotation nor mirror changes.
4. A k-d tree over the ratios answers: which patterns are within this tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from .sky_catalogue import SkyCatalogue

RADII_DEG = (2.2, 3.2, 4.6, 6.6, 9.5, 13.5, 19.0, 27.0)
STARS_PER_CIRCLE = 7
CLOSEST_FRACTION = 0.04  # of the circle's radius: two stars closer than this are one spot to a camera of that field
SIDES = np.array(list(combinations(range(4), 2)))
QUADS = np.array(list(combinations(range(STARS_PER_CIRCLE), 4)))


def side_lengths(corners: np.ndarray) -> np.ndarray:
    """(..., 4, 3) unit vectors -> (..., 6) angles, rad, in the order of SIDES."""
    chord = np.linalg.norm(corners[..., SIDES[:, 0], :] - corners[..., SIDES[:, 1], :], axis=-1)
    return 2 * np.arcsin(np.clip(chord / 2, 0, 1))


def side_ratios(lengths: np.ndarray) -> np.ndarray:
    """(..., 6) -> (..., 5): the five shorter sides over the longest, ascending."""
    ordered = np.sort(lengths, axis=-1)
    return ordered[..., :5] / ordered[..., 5:]


def fibonacci_sphere(count: int) -> np.ndarray:
    """(count, 3) evenly spread directions."""
    i = np.arange(count) + 0.5
    z, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


def _quads_of_level(sky: SkyCatalogue, radius: float) -> np.ndarray:
    """(Q, 4) star rows of all patterns of one circle size."""
    # Only stars bright enough to be among the first few of a circle matter: thin the catalogue to 4 x that density.
    brightest = min(len(sky.directions), int(4 * STARS_PER_CIRCLE * 2 / (1 - np.cos(radius))))
    tree = cKDTree(sky.directions[:brightest])
    close = tree.query_pairs(CLOSEST_FRACTION * radius, output_type="ndarray")
    alone = np.ones(brightest, bool)
    alone[close.max(1)] = False  # rows are sorted by brightness: the fainter of a close pair goes
    rows = np.flatnonzero(alone)
    tree = cKDTree(sky.directions[rows])
    centres = fibonacci_sphere(int(4 * np.pi / (0.7 * radius) ** 2))
    members = tree.query_ball_point(centres, 2 * np.sin(radius / 2), return_sorted=True)
    top = {tuple(rows[m[:STARS_PER_CIRCLE]]) for m in members if len(m) >= 4}
    full = np.array([t for t in top if len(t) == STARS_PER_CIRCLE]).reshape(-1, STARS_PER_CIRCLE)
    quads = [full[:, QUADS].reshape(-1, 4)]
    quads += [np.array(list(combinations(t, 4))) for t in top if len(t) < STARS_PER_CIRCLE]
    return np.concatenate(quads)


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
        every = np.sort(np.concatenate([_quads_of_level(sky, r) for r in wanted]), axis=1).astype(np.int64)
        n = len(sky.directions)
        keys = np.unique(((every[:, 0] * n + every[:, 1]) * n + every[:, 2]) * n + every[:, 3])
        rows = np.stack([keys // n**3, keys // n**2 % n, keys // n % n, keys % n], -1).astype(np.int32)
        return cls.from_rows(sky, rows)
