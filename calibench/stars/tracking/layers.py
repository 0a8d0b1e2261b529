"""What tracking needs of a map, made ready once for all frames of one exposure, so that a frame is touched in windows only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...calmap.correct import QUANTISATION_DN2, require_size
from ...records import UNUSABLE, CalibrationMap, Frame, PsfMap
from ...spots.psf import moments_at

UNKNOWN_SIGMA_PX = 1.0


@dataclass(frozen=True, kw_only=True)
class Layers:
    """level_dn (H, W) float32: offset and dark charge; response (H, W) float32; bad (H, W) bool; gain 0 where unknown; psf None
    where it was not measured."""

    level_dn: np.ndarray
    response: np.ndarray
    bad: np.ndarray
    gain_dn_per_e: float
    read_variance_dn2: float
    saturation_dn: float
    psf: PsfMap | None

    @classmethod
    def of(cls, calmap: CalibrationMap, frame: Frame) -> Layers:
        """The layers for frames taken like this one.

        Raises:
            BadInput: the frame has another size than the map.
        """
        require_size(frame, calmap)
        shape = frame.data.shape
        dark = calmap.dark_rate_dn_per_s * (frame.exposure_s or 0.0)
        response = np.broadcast_to(calmap.response, shape)
        bad = ((np.broadcast_to(calmap.defects, shape) & UNUSABLE) != 0) | ~(response > 0)
        measured = calmap.measured
        read = np.median(calmap.read_noise_dn) ** 2 if "read_noise_dn" in measured else QUANTISATION_DN2
        level = np.broadcast_to(calmap.offset_dn + dark, shape)
        return cls(level_dn=np.ascontiguousarray(level, np.float32),
                   response=np.ascontiguousarray(np.where(response > 0, response, 1), np.float32), bad=bad,
                   gain_dn_per_e=calmap.gain_dn_per_e if "gain_dn_per_e" in measured else 0.0, read_variance_dn2=float(read),
                   saturation_dn=float(min(frame.white_level_dn, calmap.saturation_dn)),
                   psf=calmap.psf if "psf" in measured else None)

    def moments_px2(self, xy_px: np.ndarray) -> np.ndarray:
        """Second moments (N, 3) of the light at (N, 2), pixel not included; a round spot where the PSF is not known."""
        if self.psf is None:
            return np.tile([UNKNOWN_SIGMA_PX**2, UNKNOWN_SIGMA_PX**2, 0.0], (len(xy_px), 1))
        return moments_at(self.psf, xy_px)
