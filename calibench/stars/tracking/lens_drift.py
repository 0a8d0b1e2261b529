"""LensDrift: how focal length and principal point have moved since the lens was measured, from the residuals of a series.

A Kalman filter of three numbers: relative focal length, cx, cy. One frame can hardly tell a shift of the principal point from a
rotation; the attitude is therefore eliminated from each frame's normal equations, and what is left adds up over the frames.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...geometry.kernels import solve3
from ...records import Intrinsics

# What a frame may add to the drift, 1 sigma: a focus that moves by 0.2 % (3 px at 1400) in an hour at 10 frames a second.
WALK_COVARIANCE = np.diag([1e-5, 0.003, 0.003]) ** 2
UNKNOWN_SD = np.array([0.01, 10.0, 10.0])
SIGNIFICANT = 5.0  # sigma


@dataclass(frozen=True, kw_only=True)
class LensDrift:
    """state (3,): relative change of the focal lengths, shift of cx and cy in px; covariance (3, 3)."""

    state: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of(cls, lens: Intrinsics) -> LensDrift:
        """No drift yet, as unsure as the lens's own covariance."""
        sd = np.sqrt(np.diag(lens.covariance)[[0, 2, 3]]) / [lens.fx_px, 1, 1]
        return cls(state=np.zeros(3), covariance=np.diag(np.minimum(sd, UNKNOWN_SD) ** 2))

    def applied_to(self, lens: Intrinsics) -> Intrinsics:
        """The lens as it is now. What is not significant is not applied: it would only add its noise to every attitude."""
        applied = self._applied()
        if not applied.any():
            return lens
        scale, cx, cy = applied.tolist()
        return replace(lens, fx_px=lens.fx_px * (1 + scale), fy_px=lens.fy_px * (1 + scale), cx_px=lens.cx_px + cx,
                       cy_px=lens.cy_px + cy)

    def _applied(self) -> np.ndarray:
        return np.where(self.state**2 > SIGNIFICANT**2 * np.diagonal(self.covariance), self.state, 0.0)

    def after(self, information: np.ndarray, gradient: np.ndarray) -> LensDrift:
        """The drift after one more frame: its normal matrix (3, 3) and gradient (3,) about the lens as applied, rotation
        eliminated (kernels.spread_of)."""
        gradient = gradient - information @ (self.state - self._applied())
        nothing = np.zeros(3)
        before, _, _ = solve3(self.covariance + WALK_COVARIANCE, nothing)
        covariance, _, _ = solve3(before + information, nothing)
        return LensDrift(state=self.state + covariance @ gradient, covariance=covariance)
