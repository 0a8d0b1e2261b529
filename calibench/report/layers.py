"""The maps of a measurement, as sections look at them."""

from __future__ import annotations

import numpy as np

from ..records import Measurement


def layer(measurement: Measurement, name: str) -> np.ndarray | None:
    """(H, W) map as it was measured, NaN where it is not finite; None where there is none."""
    values = measurement.maps.get(name)
    return None if values is None else np.where(np.isfinite(values), values, np.nan)
