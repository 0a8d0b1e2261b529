"""SkyCatalogue: the star table seen by an observer, ready to be searched."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..geometry import sphere
from ..records import Observer, StarTable

GRID_CELLS = 50  # along each axis of the cube about the sphere: cells of 2.3 degrees
MAS_RAD = np.pi / 180 / 3600 / 1000


def star_directions(table: StarTable, observer: Observer) -> np.ndarray:
    """(N, 3) unit vectors in ICRS axes as the observer sees them: proper motion, parallax, aberration, refraction.

    Without a date the observer stands still at J2000.0 (DESIGN: positions at epoch J2000.0, no aberration).
    """
    return Rest.of(table).seen_by(observer)


class Rest(NamedTuple):
    """The stars without an observer: at (N, 3) at the table's epoch, motion (N, 3) rad a year, parallax (N, 1) rad."""

    at: np.ndarray
    motion: np.ndarray
    parallax: np.ndarray
    epoch_jyear: float

    @classmethod
    def of(cls, table: StarTable) -> Rest:
        ra, dec = table.ra_rad.astype(float), table.dec_rad.astype(float)
        east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)], -1)
        north = np.stack([-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)], -1)
        motion = (table.pm_ra_mas_yr[:, None] * east + table.pm_dec_mas_yr[:, None] * north) * MAS_RAD
        parallax = np.maximum(table.parallax_mas, 0)[:, None].astype(float) * MAS_RAD
        return cls(sphere.unit_from_radec(ra, dec), motion, parallax, table.epoch_jyear)

    def seen_by(self, observer: Observer) -> np.ndarray:
        """(N, 3) unit vectors as the observer sees them."""
        moved = self.at + self.motion * (observer.epoch_jyear - self.epoch_jyear) - self.parallax * observer.position_au
        return sphere.as_seen(moved / np.sqrt((moved**2).sum(1))[:, None], observer)


class StarGrid(NamedTuple):
    """directions (N, 3), brightest first; rows (N,) of the stars sorted by cell of a cube of cells^3 about the sphere, start
    (cells^3 + 1,) of each cell's rows, which ascend."""

    directions: np.ndarray
    rows: np.ndarray
    start: np.ndarray
    cells: int

    @classmethod
    def of(cls, directions: np.ndarray) -> StarGrid:
        index = np.minimum(((directions + 1) * (GRID_CELLS / 2)).astype(np.int64), GRID_CELLS - 1)
        cell = index @ np.array([GRID_CELLS**2, GRID_CELLS, 1])
        rows = np.argsort(cell, kind="stable")
        start = np.searchsorted(cell[rows], np.arange(GRID_CELLS**3 + 1))
        return cls(directions=np.ascontiguousarray(directions), rows=rows.astype(np.int32), start=start.astype(np.int32),
                   cells=GRID_CELLS)


@dataclass(frozen=True, kw_only=True)
class SkyCatalogue:
    """directions (N, 3) as seen, magnitude (N,) Hp, brightest first."""

    table: StarTable
    observer: Observer
    directions: np.ndarray
    magnitude: np.ndarray

    @classmethod
    def seen_by(cls, table: StarTable, observer: Observer) -> SkyCatalogue:
        directions = star_directions(table, observer)
        if np.any(np.diff(table.hp_mag) < 0):
            order = np.argsort(table.hp_mag, kind="stable")
            table, directions = table.take(order), directions[order]
        return cls(table=table, observer=observer, directions=directions, magnitude=table.hp_mag.astype(float))

    @cached_property
    def tree(self) -> cKDTree:
        """Over the directions, by chord distance."""
        return cKDTree(self.directions)

    @cached_property
    def _rest(self) -> Rest:
        return Rest.of(self.table)

    def seen_at(self, rows: np.ndarray, observer: Observer) -> np.ndarray:
        """Directions (M, 3) of these rows as another observer sees them."""
        if observer is self.observer:
            return self.directions[rows]
        rest = self._rest
        return Rest(rest.at[rows], rest.motion[rows], rest.parallax[rows], rest.epoch_jyear).seen_by(observer)

    @cached_property
    def grid(self) -> StarGrid:
        """The stars by cells, for compiled loops."""
        return StarGrid.of(self.directions)

    def near(self, direction: np.ndarray, radius_rad: float) -> np.ndarray:
        """Rows of the stars within radius_rad of a direction (3,), brightest first."""
        return np.sort(self.tree.query_ball_point(direction, 2 * np.sin(min(radius_rad, np.pi) / 2)))
