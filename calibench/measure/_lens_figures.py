"""The lens's parameters as quantities, and what each view means to them, whatever target they were measured with."""

from __future__ import annotations

import numpy as np

from ..records import Intrinsics, Quantity
from ._bundle.adjust import Solution
from ._bundle.left_out import effect_sd, left_out


def lens_quantities(intrinsics: Intrinsics, source: str) -> list[Quantity]:
    """One quantity for each parameter, with the standard deviation of the lens's covariance."""
    sd = np.sqrt(np.diag(intrinsics.covariance))
    return [Quantity(name=name, value=float(value), unit="px" if name.endswith("_px") else "1",
                     symbol=name.removesuffix("_px"), uncertainty=float(error), source=source)
            for name, value, error in zip(intrinsics.parameter_names, intrinsics.parameters, sd, strict=True)]


def left_out_figures(solution: Solution, intrinsics: Intrinsics) -> tuple[Quantity, dict[str, np.ndarray]]:
    """The leave-one-view-out error, and of each view, as evidence: its part of that, and how far the lens rests on it.

    intrinsics: the solution's, with the covariance to recommend.
    """
    left = left_out(solution)
    known = np.isfinite(left.square_px2).all()
    sd = np.sqrt(np.diag(intrinsics.covariance))
    quantity = Quantity(name="leave_one_out_rms_px", value=left.rms_px if known else None, unit="px",
                        reason="" if known else "some of the views alone determine a parameter",
                        source="sqrt(mean(dx^2 + dy^2)) over inliers; each view under the lens of the others, its pose fitted")
    return quantity, {"view_left_out_rms_px": np.sqrt(left.square_px2), "view_effect_sd": effect_sd(left, intrinsics),
                      "view_effect_by_parameter_sd": left.step[:, :len(sd)] / sd}
