"""Encircled light of all spots together: the curve, and the radii of given shares with their errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...records import Quantity
from .spot_shapes import SpotShapes

ANNULUS_PX = 0.2
GROUPS = 8  # of spots; the scatter of their radii is the error


def encircled(found: Sequence[SpotShapes], rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Radius (R,) px and the share of the light within it, pixel included, over the given rows of each frame's spots.

    A pixel's share of the flux is a sample of the recorded PSF at its distance; spots at all pixel phases together sample
    it finely. The mean in each annulus times its area adds up to the curve; the window holds all light by definition.
    """
    distance = np.concatenate([s.distance_px[rows].ravel() for s in found])
    light = np.concatenate([s.light[rows].ravel() for s in found])
    rim = min(s.distance_px.max() for s in found if len(s.xy_px)) / np.sqrt(2)
    inside = np.isfinite(light) & (distance < rim)
    edges = np.arange(0, distance[inside].max() + ANNULUS_PX, ANNULUS_PX)
    total, _ = np.histogram(distance[inside], edges, weights=light[inside])
    count, _ = np.histogram(distance[inside], edges)
    middle, sampled = (edges[1:] + edges[:-1]) / 2, count > 0
    density = np.interp(middle, middle[sampled], total[sampled] / count[sampled])
    curve = np.concatenate([[0], np.cumsum(density * np.pi * np.diff(edges**2))])
    return edges, curve / curve[-1]


def encircled_radii(found: Sequence[SpotShapes], curve: tuple[np.ndarray, np.ndarray],
                    shares: Sequence[float]) -> list[Quantity]:
    """The radius that holds each share of the light on the curve of all spots; the error from GROUPS parts of them."""
    parts = [slice(i, None, GROUPS) for i in range(GROUPS)]
    curves = [encircled(found, part) for part in parts if sum(len(s.xy_px[part]) for s in found) >= 3]
    out = []
    for share in shares:
        radii = [_radius_px(one, share) for one in curves]
        percent = round(100 * share)
        out.append(Quantity(
            name=f"ee{percent}_radius_px", value=_radius_px(curve, share), unit="px", symbol=f"EE{percent}",
            uncertainty=float(np.std(radii, ddof=1) / np.sqrt(len(radii))) if len(radii) > 1 else None,
            source=f"radius of {percent} % of the light, mean of all spots, pixel included",
            reason="" if len(radii) > 1 else "too few spots for an uncertainty"))
    return out


def _radius_px(curve: tuple[np.ndarray, np.ndarray], share: float) -> float:
    radius, light = curve
    return float(np.interp(share, np.maximum.accumulate(light), radius))
