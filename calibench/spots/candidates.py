"""Candidates: what a detector hands to a centroider."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """Places that may be spots.

    xy_px (N, 2): rough centre; peak_xy (N, 2) int: brightest pixel; peak_dn, flux_dn (N,): above background, flux over
    the pixels above threshold; pixels (N,) how many those are; elongation (N,): major over minor axis; blend (N,) bool:
    its light is connected with another candidate's (a detector that does not look for this says False).
    """

    xy_px: np.ndarray
    peak_xy: np.ndarray
    peak_dn: np.ndarray
    flux_dn: np.ndarray
    pixels: np.ndarray
    elongation: np.ndarray
    blend: np.ndarray

    @classmethod
    def none(cls) -> Candidates:
        """No candidates."""
        nothing = np.zeros(0)
        return cls(xy_px=np.zeros((0, 2)), peak_xy=np.zeros((0, 2), int), peak_dn=nothing, flux_dn=nothing,
                   pixels=np.zeros(0, int), elongation=nothing, blend=np.zeros(0, bool))

    def __len__(self) -> int:
        return len(self.xy_px)

    def take(self, rows: np.ndarray) -> Candidates:
        """The candidates of these rows (index or mask), in that order."""
        return Candidates(**{f: getattr(self, f)[rows] for f in self.__dataclass_fields__})
