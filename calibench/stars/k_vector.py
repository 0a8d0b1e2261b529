"""Pairs of stars searched in the ways that are compared with bisection: row by row, and by a k-vector on a line or a parabola.

k-vector (Mortari and Neta 2000): with a curve z(j), j = 0 .. P - 1, that runs from just below the smallest of P sorted
values to just above the largest, below[j] = how many values lie under z(j). A range [low, high] is then rows below[floor
z^-1(low)] to below[floor z^-1(high) + 1], with no search; about one of these rows is not wanted.
Hashemi et al. (equations 7 to 12) put a parabola in the line's place. Their line and parabola are regressions over all
values, which do not reach the first and last of them, so that rows are lost; here both ends are held.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .star_pairs import StarPairs

MARGIN_RAD = 1e-9  # by which the curve reaches beyond the values
STEEPEST_BEND = 0.99  # of the bend at which a parabola would stop to rise within the table


class LinearPairs(NamedTuple):
    """Columns of StarPairs, searched by comparing every row."""

    angle_rad: np.ndarray
    first: np.ndarray
    second: np.ndarray

    def between(self, low_rad: float, high_rad: float) -> tuple[np.ndarray, np.ndarray]:
        """(first, second) star rows of all pairs whose angle lies in [low, high], both orders."""
        fits = (self.angle_rad >= low_rad) & (self.angle_rad <= high_rad)
        return self.first[fits], self.second[fits]


class KVectorPairs(NamedTuple):
    """Columns of StarPairs; below (P,): how many pairs lie under z(j).

    curve (3,): bend, slope and start of z(j) = start + slope j + bend j^2.
    """

    angle_rad: np.ndarray
    first: np.ndarray
    second: np.ndarray
    curve: np.ndarray
    below: np.ndarray

    @classmethod
    def of(cls, pairs: StarPairs, *, quadratic: bool) -> KVectorPairs:
        """The pairs with a k-vector on the line, or on the parabola of least squares, between both ends."""
        curve = curve_through(pairs.angle_rad, quadratic=quadratic)
        z = np.polyval(curve, np.arange(len(pairs.angle_rad)))
        return cls(*pairs, curve=curve, below=np.searchsorted(pairs.angle_rad, z).astype(np.int32))

    def rows(self, low_rad: float, high_rad: float) -> tuple[int, int]:
        """Rows i to j that hold all pairs in [low, high], and some beside."""
        bend, slope, start = self.curve
        last = len(self.below) - 1
        if last < 1:
            return 0, last + 1
        end = start + last * (slope + bend * last)
        rise = np.clip([low_rad, high_rad], start, end) - start
        root = 2 * rise / (slope + np.sqrt(slope**2 + 4 * bend * rise))  # the form that no cancellation harms
        at = np.clip(root, 0, last).astype(int)
        return int(self.below[at[0]]), int(self.below[min(at[1] + 1, last)])

    def between(self, low_rad: float, high_rad: float) -> tuple[np.ndarray, np.ndarray]:
        """(first, second) star rows of all pairs whose angle lies in [low, high], both orders."""
        i, j = self.rows(low_rad, high_rad)
        fits = (self.angle_rad[i:j] >= low_rad) & (self.angle_rad[i:j] <= high_rad)
        return self.first[i:j][fits], self.second[i:j][fits]


def curve_through(ascending: np.ndarray, *, quadratic: bool) -> np.ndarray:
    """(bend, slope, start) of a rising curve over the rows (P,) from just below the first value to just above the last."""
    last = len(ascending) - 1
    if last < 1:
        return np.zeros(3)
    start = ascending[0] - MARGIN_RAD
    slope, bend = (ascending[-1] + MARGIN_RAD - start) / last, 0.0
    if quadratic:
        row = np.arange(last + 1.0)
        sag = row * (row - last)
        bend = float(sag @ (ascending - start - slope * row) / (sag @ sag)) if last > 1 else 0.0
        most = STEEPEST_BEND * slope / last
        bend = min(max(bend, -most), most)
    return np.array([bend, slope - bend * last, start])
