"""Photon transfer: the system gain from how temporal variance grows with the mean (EMVA 1288 R4 Linear, 6.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

MAX_FILL = 0.7  # of saturation: beyond it the variance shrinks
MIN_LEVELS_FOR_OFFSET = 3


@dataclass(frozen=True, kw_only=True)
class TransferPoint:
    """One light level: mean above dark, temporal variance above dark's, and the 1-sigma error of the latter."""

    signal_dn: float
    variance_dn2: float
    variance_uncertainty_dn2: float


def gain(points: list[TransferPoint]) -> tuple[float, float, str]:
    """Gain in DN/e-, its 1-sigma uncertainty, and how it was had.

    From three levels on the slope of the line with free offset (release 4: every level counts alike); fewer give the
    ratio. The uncertainty is widened where the points scatter about the line more than their errors allow.
    """
    signal, variance, error = (np.array([getattr(p, f) for p in points]) for f in TransferPoint.__dataclass_fields__)
    free = len(points) >= MIN_LEVELS_FOR_OFFSET
    solver = np.linalg.pinv(np.stack([signal, np.ones_like(signal)], -1)[:, : 2 if free else 1])
    line = solver @ variance
    residual = variance - line[0] * signal - (line[1] if free else 0)
    freedom = len(points) - len(line)
    scatter = np.sqrt(np.sum(residual**2) / freedom) if freedom else 0.0
    how = f"slope over {len(points)} levels, free offset" if free else f"ratio at {len(points)} level{'s'[: len(points) - 1]}"
    return float(line[0]), float(np.linalg.norm(solver[0] * np.maximum(error, scatter))), how
