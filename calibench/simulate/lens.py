"""The simulated lens apart from its geometry: aperture, throughput, vignetting, and the dust on the cover glass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Lens:
    """throughput: of glass and coatings. The barrel cuts the beam beyond the field radius barrel_from (1 at the corner) down to
    barrel_at_corner there. dust_shadows: out-of-focus grains, part of the camera: they shade every scene alike."""

    focal_mm: float
    f_number: float
    throughput: float
    barrel_from: float
    barrel_at_corner: float
    dust_shadows: int

    @property
    def aperture_cm2(self) -> float:
        """Area of the entrance pupil."""
        return np.pi / 4 * (self.focal_mm / self.f_number / 10) ** 2


def transmission(lens: Lens, rays: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Relative light (H, W) that reaches each pixel from an evenly bright scene; 1 on the axis apart from dust.

    rays: (H, W, 3) unit vectors of the pixel centres. cos^4 of the field angle times the barrel's smooth cut times dust.
    """
    height, width = rays.shape[:2]
    cos = rays[..., 2]
    tangent = np.sqrt(1 - cos**2) / cos
    beyond = np.clip((tangent / tangent.max() - lens.barrel_from) / (1 - lens.barrel_from), 0, 1)
    barrel = 1 - (1 - lens.barrel_at_corner) * beyond**2 * (3 - 2 * beyond)
    out = cos**4 * barrel
    rows, cols = np.mgrid[:height, :width]
    for _ in range(lens.dust_shadows):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        radius, depth = rng.uniform(5, 14), rng.uniform(0.01, 0.05)
        # The blurred disc that a grain throws in a fast beam: flat inside, soft at its rim.
        rim = np.minimum((np.hypot(cols - x, rows - y) - radius) / 1.5, 700)  # exp overflows beyond
        out *= 1 - depth / (1 + np.exp(rim))
    return out
