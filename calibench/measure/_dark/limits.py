"""What bounds a dark: rounding to whole DN, and the exposures and rates beyond which the unit of time is wrong."""

from __future__ import annotations

import numpy as np

from ...errors import BadInput

MAX_EXPOSURE_S = 86400.0
MAX_RATE_E_PER_S = 1e5
MIN_TIME_TO_FILL_S = 0.1
QUANTISATION_DN2 = 1 / 12  # variance of rounding to whole DN (EMVA 1288)


def check_exposure(longest_s: float) -> None:
    """Raises BadInput where it is absurd."""
    if longest_s > MAX_EXPOSURE_S:
        raise BadInput(f"an exposure of {longest_s:g} s is longer than a day", mend="give exposures in seconds")


def check_rate(rate_dn_per_s: float, white_level_dn: float, gain_dn_per_e: float) -> None:
    """Raises BadInput where the mean dark rate is absurd; the gain is NaN where unknown."""
    limit = MAX_RATE_E_PER_S * gain_dn_per_e if np.isfinite(gain_dn_per_e) else white_level_dn / MIN_TIME_TO_FILL_S
    if abs(rate_dn_per_s) > limit:
        unknown = not np.isfinite(gain_dn_per_e)
        figure = f"{rate_dn_per_s:.3g} DN/s" if unknown else f"{rate_dn_per_s / gain_dn_per_e:.3g} e-/s"
        raise BadInput(f"a mean dark rate of {figure} is absurd", mend="give exposures in seconds; were frames of different "
                       "exposure or temperature mixed up?")
