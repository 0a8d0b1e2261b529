"""The lens's parameters as quantities, whatever target they were measured with."""

from __future__ import annotations

import numpy as np

from ..records import Intrinsics, Quantity


def lens_quantities(intrinsics: Intrinsics, source: str) -> list[Quantity]:
    """One quantity for each parameter, with the standard deviation of the lens's covariance."""
    sd = np.sqrt(np.diag(intrinsics.covariance))
    return [Quantity(name=name, value=float(value), unit="px" if name.endswith("_px") else "1",
                     symbol=name.removesuffix("_px"), uncertainty=float(error), source=source)
            for name, value, error in zip(intrinsics.parameter_names, intrinsics.parameters, sd, strict=True)]
