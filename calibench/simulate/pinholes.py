"""A mask of unresolved pinholes, back-lit and collimated: point sources at known places over the field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .camera import SimulatedCamera
from .psf import chief_ray_px, render_sources


@dataclass(frozen=True, kw_only=True)
class PinholeImage:
    """light_e (H, W): expected electrons; xy_px (N, 2) centres of mass, chief_ray_px (N, 2), flux_e (N,)."""

    light_e: np.ndarray
    xy_px: np.ndarray
    chief_ray_px: np.ndarray
    flux_e: np.ndarray


def pinholes(camera: SimulatedCamera, *, columns: int, rows: int, flux_e: float, rng: np.random.Generator,
             diameter_px: float = 0.0) -> PinholeImage:
    """A grid of columns x rows spots from edge to edge, each moved by its own part of a pixel (+-0.5 px in x and y), so that a
    few frames sample every pixel phase everywhere. flux_e: electrons of a spot on the axis. diameter_px: of its own image."""
    width, height = camera.image_size_px
    margin_px = 12
    grid_x, grid_y = np.meshgrid(np.linspace(margin_px, width - 1 - margin_px, columns),
                                 np.linspace(margin_px, height - 1 - margin_px, rows))
    xy_px = np.column_stack([grid_x.ravel(), grid_y.ravel()]) + rng.uniform(-0.5, 0.5, (columns * rows, 2))
    nearest_x, nearest_y = np.rint(xy_px).astype(int).T
    flux = flux_e * camera.transmission[nearest_y, nearest_x]
    light_e = render_sources(camera.aberrations, xy_px, flux, (width, height), pinhole_px=diameter_px)
    return PinholeImage(light_e=light_e, xy_px=xy_px, chief_ray_px=chief_ray_px(camera.aberrations, xy_px), flux_e=flux)
