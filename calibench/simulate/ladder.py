"""A ladder of light on the bare sensor, from dark to saturation: the frames of a photon transfer measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class LightLadder:
    """Even light without a lens, varied by exposure; each exposure is taken with light and without.

    photons_per_px_s: on each pixel. frames: of each level. stack_frames: further ones at the level next to half of the range.
    """

    exposures_s: tuple[float, ...]
    photons_per_px_s: float
    frames: int
    stack_frames: int

    @property
    def shots(self) -> tuple[tuple[float, int], ...]:
        """(exposure_s, frames) of each level, lit or dark."""
        half = int(np.argmin(np.abs(np.array(self.exposures_s) - self.exposures_s[-1] / 2)))
        return tuple((t, self.frames + (i == half) * self.stack_frames) for i, t in enumerate(self.exposures_s))

