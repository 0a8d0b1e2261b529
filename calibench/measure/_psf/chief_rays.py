"""How far the light's centre lies from the chief ray, where the bench's stage says where the chief rays are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from ...records import Quantity
from .quantities import median

FARTHEST_PX = 3.0  # a spot farther from every chief ray belongs to none
FEWEST = 3


def chief_ray_shifts(xy_px: np.ndarray, frame: np.ndarray, chief_rays_px: Sequence[np.ndarray | None]) -> np.ndarray:
    """(N, 2) place of each spot (N, 2) of frame number (N,) less that of its chief ray; NaN where there is none near."""
    out = np.full(xy_px.shape, np.nan)
    for number, rays in enumerate(chief_rays_px):
        rows = np.flatnonzero(frame == number)
        if rays is None or not len(rays) or not len(rows):
            continue
        distance, nearest = cKDTree(np.asarray(rays, float)).query(xy_px[rows])
        near = distance < FARTHEST_PX
        out[rows[near]] = xy_px[rows[near]] - np.asarray(rays, float)[nearest[near]]
    return out


def shift_quantity(shift_px: np.ndarray, centre: str) -> Quantity:
    """Median length of the shifts over the field."""
    length = np.hypot(*shift_px[np.isfinite(shift_px).all(1)].T)
    source = f"median distance of a spot's place ({centre}) from its chief ray, as the stage states it"
    if len(length) >= FEWEST:
        return median("chief_ray_shift_px", length, "px", source)
    return Quantity(name="chief_ray_shift_px", value=None, unit="px", source=source,
                    reason="needs the chief rays' places (chief_rays_px in the frames' sidecars)")
