"""The response's bend, and whether correcting it helps on levels that the correction has not seen.

The light needed for one DN, H / s, is constant over the signal s of a linear camera. Its polynomial in s is the correction; a
term 1 / s takes up what an exposure that is longer or shorter than stated by a constant does, which is no bend.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .curve import Curve

DEGREES = (0, 1, 2, 3)
LINEAR_FILL = (0.05, 0.95)
FEWEST_LEVELS = 12
SURE = 3.0  # standard errors by which a further degree has to lower the held-out error, and
WORTH = 0.8  # to what part of it (rms)
KNOTS = 33


def correction(curves: Sequence[Curve]) -> np.ndarray | None:
    """(KNOTS, 2) signal above dark and what it would be in a linear camera, DN; None where no bend is sure.

    One curve for all planes: they share the converter. Scaled so that the slope over the light stays the same up to 70 %.
    """
    parts = [_levels(c) for c in curves]
    if any(part is None or len(part[0]) < FEWEST_LEVELS for part in parts):
        return None
    signal, need, plane = (np.concatenate(x) for x in zip(*[(s, q, np.full(len(s), i)) for i, (s, q) in enumerate(parts)],
                                                          strict=True))
    full = signal.max()
    odd = np.concatenate([np.arange(len(s)) % 2 == 1 for s, _ in parts])
    errors = {d: _held_out(signal / full, need, plane, odd, d) for d in DEGREES}
    best = 0
    for degree in DEGREES[1:]:
        gain = errors[best] - errors[degree]
        sure = gain.mean() > SURE * gain.std(ddof=1) / np.sqrt(len(gain))
        if sure and errors[degree].mean() < WORTH**2 * errors[best].mean():
            best = degree
    if best == 0:
        return None
    bend = np.append(1.0, _fit(signal / full, need, plane, best)[-best:])  # relative to the dim end
    knots = np.linspace(0, 1, KNOTS)
    fitted = np.concatenate([c.signal_dn[c.fitted] for c in curves]) / full
    scale = np.sum(fitted**2) / np.sum(fitted**2 * np.polyval(bend[::-1], fitted))
    linear = knots * np.polyval(bend[::-1], knots) * scale
    return None if np.any(np.diff(linear) <= 0) else full * np.stack([knots, linear], -1)


def _levels(curve: Curve) -> tuple[np.ndarray, np.ndarray] | None:
    if not curve.light_unit:
        return None
    used = curve.below(LINEAR_FILL[1], LINEAR_FILL[0]) & (curve.signal_dn > 0)
    need = curve.light[used] / curve.signal_dn[used]
    return curve.signal_dn[used], need / np.median(need) if used.any() else need


def _fit(s: np.ndarray, need: np.ndarray, plane: np.ndarray, degree: int) -> np.ndarray:
    """Coefficients: one level and one 1/s term a plane, then s, s^2, ... common to all, relative to the mean level."""
    found = np.linalg.lstsq(_design(s, plane, degree), need, rcond=None)[0]
    planes = int(plane.max()) + 1
    found[2 * planes:] /= np.mean(found[:planes])
    return found


def _design(s: np.ndarray, plane: np.ndarray, degree: int) -> np.ndarray:
    own = plane[:, None] == np.arange(plane.max() + 1)
    return np.column_stack([own, own / s[:, None], *(s**d for d in range(1, degree + 1))])


def _held_out(s: np.ndarray, need: np.ndarray, plane: np.ndarray, odd: np.ndarray, degree: int) -> np.ndarray:
    """Squared relative error of each level by the fit to the other half."""
    out = np.empty(len(s))
    for half in (odd, ~odd):
        design = _design(s, plane, degree)
        found = np.linalg.lstsq(design[~half], need[~half], rcond=None)[0]
        out[half] = (need[half] - design[half] @ found) ** 2
    return out
