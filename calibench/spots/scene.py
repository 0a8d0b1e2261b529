"""Scene: one frame made ready for centroids. Patches: its windows. Centroids: what comes back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..records import PsfMap
from .cut import cut

NAN = np.float32(np.nan)


@dataclass(frozen=True, kw_only=True)
class Patches:
    """Windows of a scene: signal_dn (N, n, n) float32 above the background, NaN where a pixel cannot be used or lies beyond the
    edge; floor_variance_dn2 (N, n, n) float32, of a pixel without the light of stars; corner_xy (N, 2): the frame's pixel
    at [0, 0]. A centroider may write to them: they are its own."""

    signal_dn: np.ndarray
    floor_variance_dn2: np.ndarray
    corner_xy: np.ndarray

    def take(self, rows: np.ndarray) -> Patches:
        """The windows of these rows."""
        return Patches(**{name: getattr(self, name)[rows] for name in self.__dataclass_fields__})


class Scene(Protocol):
    """What a centroider asks for.

    psf: the PSF map; psf_known False: its shape is a guess, and the moments shape_px2 (3,) hold in its place, or, where these
    are None, what the frame's own stars tell (spots/frame_shape.py)."""

    gain_dn_per_e: float
    psf: PsfMap
    psf_known: bool
    shape_px2: np.ndarray | None

    def patches(self, centre_xy: np.ndarray, radius: int) -> Patches:
        """Windows of 2 radius + 1 pixels about integer centres (N, 2), one for each candidate, in their order."""


@dataclass(frozen=True, kw_only=True)
class FrameScene:
    """A whole corrected frame as a Scene. signal_dn (H, W): above background. floor_variance_dn2 (H, W): of a pixel without
    stars. unusable (H, W) bool."""

    signal_dn: np.ndarray
    floor_variance_dn2: np.ndarray
    unusable: np.ndarray
    gain_dn_per_e: float
    psf: PsfMap
    psf_known: bool
    shape_px2: np.ndarray | None = None

    def patches(self, centre_xy: np.ndarray, radius: int) -> Patches:
        """Windows of 2 radius + 1 pixels about integer centres (N, 2)."""
        signal = cut(self.signal_dn, centre_xy, radius, NAN).astype(np.float32)
        signal[cut(self.unusable, centre_xy, radius, True)] = NAN
        floor = cut(self.floor_variance_dn2, centre_xy, radius, np.float32(1)).astype(np.float32)
        return Patches(signal_dn=signal, floor_variance_dn2=floor, corner_xy=centre_xy - radius)


@dataclass(frozen=True, kw_only=True)
class Centroids:
    """xy_px (N, 2), covariance_px2 (N, 2, 2), flux_dn (N,), background_dn (N,) left over, ok (N,) bool."""

    xy_px: np.ndarray
    covariance_px2: np.ndarray
    flux_dn: np.ndarray
    background_dn: np.ndarray
    ok: np.ndarray

    def with_rows(self, rows: np.ndarray, others: Centroids) -> Centroids:
        """These, those of rows (N,) bool replaced by others."""
        out = {name: getattr(self, name).copy() for name in self.__dataclass_fields__}
        for name, values in out.items():
            values[rows] = getattr(others, name)
        return Centroids(**out)
