"""Radial and cyclic features (Zhang, Wei and Jiang 2008): first the distances to the stars around, then the azimuths.

1. Radial: as polestar, the rings of a spot's neighbours vote for stars.
2. Cyclic: a candidate's neighbours at the distances of the spot's say by how much the image is turned; the turn on which
   most agree within tolerance is taken, and the spot with the neighbours of that turn is proposed.
Zhang et al. compare a bit string of sectors under cyclic shifts; here azimuths are compared themselves, because a sector's
edge loses the neighbours near it, and their tolerance follows from the spots' covariance: sigma over the distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..sky_catalogue import SkyCatalogue
from ..view import TOLERANCE_SIGMA, View, field_key
from . import _neighbourhoods, _votes, polestar
from ._neighbourhoods import Neighbourhoods

NEEDS_SCALE = True
table_key = field_key
SPOTS = polestar.SPOTS
FEWEST_AGREEING = 2


class Table(NamedTuple):
    """Columns of polestar's table, of the rings; then those of Neighbourhoods."""

    ring_pole: np.ndarray
    start: np.ndarray
    width: np.ndarray
    pole: np.ndarray
    neighbour: np.ndarray
    distance_rad: np.ndarray
    azimuth_rad: np.ndarray


def build(sky: SkyCatalogue, key: float) -> Table:
    """The rings about the brightest stars of every circle of the field's size, and their neighbourhoods."""
    stars = _neighbourhoods.of_stars(sky, key)
    return Table(*polestar.table_of(stars, polestar.RING * min(key, np.pi / 2)), *stars)


def propose(view: View, sky: SkyCatalogue, table: Table) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (1, k) spot rows, (1, k) star rows: a spot and its neighbours, the most agreeing first."""
    rings, stars = polestar.Table(*table[:3]), Neighbourhoods(*table[3:])
    radius = len(rings.start) * float(rings.width[0])
    for last in SPOTS:
        spots = _neighbourhoods.neighbourhoods(view.directions[:last], radius)
        found = []
        for pole in range(min(last, len(view.directions))):
            around = spots.of(pole)
            for star in _votes.most_voted(polestar.votes(view, rings, around, len(sky.directions))):
                found.append(aligned(view, around, stars.of(star)))
        for spot_rows, star_rows in sorted(found, key=lambda pair: -len(pair[0])):
            if len(spot_rows) > FEWEST_AGREEING:
                yield spot_rows[None], star_rows[None]
        if last >= len(view.directions):
            return


def aligned(view: View, spots: Neighbourhoods, stars: Neighbourhoods) -> tuple[np.ndarray, np.ndarray]:
    """Rows (k,) of a spot with its neighbours and of a star with its own, that agree best in distance and one common turn."""
    sigma = TOLERANCE_SIGMA * _neighbourhoods.pair_error(view.sigma_rad, spots)
    slack = (view.scale_slack + view.ratio_error) * spots.distance_rad
    apart = np.abs(spots.distance_rad[:, None] - stars.distance_rad)
    i, j = np.nonzero(apart < (sigma + slack)[:, None])
    if not len(i):
        return np.zeros(0, int), np.zeros(0, int)
    turn, error = spots.azimuth_rad[i] - stars.azimuth_rad[j], (sigma / spots.distance_rad)[i]
    off = np.abs(np.angle(np.exp(1j * (turn[:, None] - turn))))
    agree = off < np.hypot(error[:, None], error)
    best = agree[agree.sum(1).argmax()]
    i, j = i[best], j[best]
    one_each = np.unique(i, return_index=True)[1]
    i, j = i[one_each], j[one_each]
    return np.append(spots.pole[0], spots.neighbour[i]), np.append(stars.pole[0], stars.neighbour[j])
