"""Stars and their neighbours within a pattern's radius: what the identifiers that describe one star by those around it share.

The neighbourhood of a star is a list of distances and azimuths about it; azimuths turn counter-clockwise in camera and sky
alike, from a zero that means nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ...geometry import sphere
from ..circles import brightest_groups
from ..sky_catalogue import SkyCatalogue

RADIUS = 0.7  # of the half diagonal: a pattern at the centre of a 3:2 frame fits in
STARS_PER_CIRCLE = 20


class Neighbourhoods(NamedTuple):
    """pole, neighbour (P,) rows, poles ascending and the nearest neighbour first; distance_rad, azimuth_rad (P,)."""

    pole: np.ndarray
    neighbour: np.ndarray
    distance_rad: np.ndarray
    azimuth_rad: np.ndarray

    def of(self, pole: int) -> Neighbourhoods:
        """One pole's own."""
        i, j = np.searchsorted(self.pole, [pole, pole + 1])
        return Neighbourhoods(*(column[i:j] for column in self))


def neighbourhoods(directions: np.ndarray, radius_rad: float) -> Neighbourhoods:
    """Of every direction (N, 3): all others within the radius."""
    chord = 2 * np.sin(min(radius_rad, np.pi) / 2)
    pairs = cKDTree(directions).query_pairs(chord, output_type="ndarray").reshape(-1, 2)
    pole, neighbour = np.concatenate([pairs, pairs[:, ::-1]]).T
    at, other = directions[pole], directions[neighbour]
    distance = sphere.angle_between(at, other)
    # The axis on which the pole's direction is shortest is far from it: a zero of azimuth that is nowhere undefined.
    east = np.cross(np.eye(3)[np.abs(at).argmin(1)], at)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    azimuth = np.arctan2((np.cross(at, east) * other).sum(1), (east * other).sum(1))
    order = np.lexsort((distance, pole))
    return Neighbourhoods(pole[order], neighbour[order], distance[order], azimuth[order])


def of_stars(sky: SkyCatalogue, half_diagonal_rad: float) -> Neighbourhoods:
    """Of the brightest stars of every circle of the field's size, as rows of the catalogue."""
    half = min(half_diagonal_rad, np.pi / 2)
    stars = brightest_groups(sky, half, STARS_PER_CIRCLE, 1)[:, 0]
    found = neighbourhoods(sky.directions[stars], RADIUS * half)
    return found._replace(pole=stars[found.pole], neighbour=stars[found.neighbour])


def pair_error(sigma_rad: np.ndarray, spots: Neighbourhoods) -> np.ndarray:
    """Sigma (P,), rad, of each distance, and of each neighbour's place about its pole."""
    return np.hypot(sigma_rad[spots.pole], sigma_rad[spots.neighbour])
