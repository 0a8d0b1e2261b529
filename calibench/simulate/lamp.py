"""An evenly meant lamp in front of the simulated camera: the light of a flat."""

from __future__ import annotations

import numpy as np

from .camera import SimulatedCamera

_GRADIENT = 0.03
_BOW = 0.02


def lit_flat(camera: SimulatedCamera, *, peak_e: float) -> np.ndarray:
    """Expected electrons (H, W) of a flat: a lamp with a slight tilt and bow, through vignetting and dust.

    The lamp falls by 3 % from the left edge to the right and by 2 % from the middle to top and bottom; peak_e is the
    light where lamp and lens are brightest.
    """
    width, height = camera.image_size_px
    across, down = np.linspace(-0.5, 0.5, width), np.linspace(-1, 1, height)[:, None]
    light = (1 - _GRADIENT * across - _BOW * down**2) * camera.transmission
    return peak_e * light / light.max()
