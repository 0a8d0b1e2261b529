"""A mosaic's colours apart: each plane's PSF from its own pixels, and where its spots lie beside the green ones.

All planes are fitted in the sensor's coordinates, a pixel of another colour being a pixel that is not there. So the centres
speak of one grid and their difference is lateral colour.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ...records import Quantity

MAIN = "g"
NEAREST_PX = 1.5
FEWEST = 6


def colour_pixels(shape: tuple[int, int], bayer_pattern: str | None) -> dict[str, np.ndarray | None]:
    """Colour -> its pixels (H, W) bool, green (both greens of a cell) first; {"": None} where there is no mosaic."""
    if bayer_pattern is None:
        return {"": None}
    rows, columns = np.indices(shape) % 2
    of = np.array(list(bayer_pattern.lower()))[2 * rows + columns]
    return {colour: of == colour for colour in (MAIN, "r", "b")}


def of_colour(quantities: list[Quantity], colour: str) -> list[Quantity]:
    """The same figures under the colour's names."""
    return [replace(q, name=f"{q.name}_{colour}", source=f"{q.source}; {colour} pixels") for q in quantities]


def lateral_colour(colour: str, xy_px: np.ndarray, frame: np.ndarray, green_xy_px: np.ndarray, green_frame: np.ndarray,
                   image_size_px: tuple[int, int]) -> tuple[Quantity, dict[str, np.ndarray]]:
    """Shift of a colour's spots (N, 2) of frames (N,) from the green ones at the corner, outward; a common shift is left out.

    The evidence holds the shift of each spot that both colours see.
    """
    places, shifts = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for number in np.unique(green_frame):
        green, mine = green_xy_px[green_frame == number], xy_px[frame == number]
        if not len(mine):
            continue
        distance, nearest = cKDTree(green).query(mine)
        near = distance < NEAREST_PX
        places.append(green[nearest[near]])
        shifts.append((mine - green[nearest])[near])
    at, shift = np.concatenate(places), np.concatenate(shifts)
    size = np.array(image_size_px) - 1
    value = error = None
    if len(at) >= FEWEST:
        outward = (at - size / 2) / (np.hypot(*size) / 2)
        design = np.vstack([np.column_stack([np.ones(len(at)), np.zeros(len(at)), outward[:, 0]]),
                            np.column_stack([np.zeros(len(at)), np.ones(len(at)), outward[:, 1]])])
        found = np.linalg.lstsq(design, shift.T.ravel(), rcond=None)[0]
        residual = shift.T.ravel() - design @ found
        value = float(found[2])
        error = float(1.4826 * np.median(np.abs(residual)) * np.sqrt(np.linalg.inv(design.T @ design)[2, 2]))
    quantity = Quantity(name=f"lateral_colour_{colour}_px", value=value, uncertainty=error, unit="px",
                        source="shift of the colour's spots from the green ones at the corner, outward positive, by a scale",
                        reason="" if value is not None else f"{len(at)} spots seen in both colours, {FEWEST} are the least")
    return quantity, {f"lateral_{colour}_xy_px": at, f"lateral_{colour}_px": shift}
