"""Candidates: what a detector hands to a centroider."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """Places that may be spots.

    xy_px (N, 2): rough centre; peak_xy (N, 2) int: brightest pixel; peak_dn, flux_dn (N,): above background, flux over
    the pixels above threshold; pixels (N,) how many those are; elongation (N,): major over minor axis.
    """

    xy_px: np.ndarray
    peak_xy: np.ndarray
    peak_dn: np.ndarray
    flux_dn: np.ndarray
    pixels: np.ndarray
    elongation: np.ndarray

    def __len__(self) -> int:
        return len(self.xy_px)

    def take(self, rows: np.ndarray) -> Candidates:
        """The candidates of these rows (index or mask), in that order."""
        return Candidates(**{f: getattr(self, f)[rows] for f in self.__dataclass_fields__})
