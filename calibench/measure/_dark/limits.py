"""What bounds a dark: rounding to whole DN, and the exposures and rates beyond which the unit of time is wrong."""

from __future__ import annotations

import numpy as np

from ...errors import BadInput

MAX_EXPOSURE_S = 86400.0
MAX_RATE_E_PER_S = 1e5
MIN_TIME_TO_FILL_S = 0.1
ODD_TIME_TO_FILL_S = 10.0  # a dark signal that fills the range sooner is said
FALLING_SIGMA = 5.0
FALL_SHARE = 0.01  # of the range: what corrections on the chip make stays below
QUANTISATION_DN2 = 1 / 12  # variance of rounding to whole DN (EMVA 1288)


def check_exposure(longest_s: float) -> None:
    """Raises BadInput where it is absurd."""
    if longest_s > MAX_EXPOSURE_S:
        raise BadInput(f"an exposure of {longest_s:g} s is longer than a day", mend="give exposures in seconds")


def check_rate(rate_dn_per_s: float, longest_s: float, white_level_dn: float, gain_dn_per_e: float) -> None:
    """Raises BadInput where the mean dark rate is absurd, or so far below zero that no dark current is in it; the gain is NaN
    where unknown."""
    limit = MAX_RATE_E_PER_S * gain_dn_per_e if np.isfinite(gain_dn_per_e) else white_level_dn / MIN_TIME_TO_FILL_S
    if abs(rate_dn_per_s) > limit:
        unknown = not np.isfinite(gain_dn_per_e)
        figure = f"{rate_dn_per_s:.3g} DN/s" if unknown else f"{rate_dn_per_s / gain_dn_per_e:.3g} e-/s"
        raise BadInput(f"a mean dark rate of {figure} is absurd", mend="give exposures in seconds; were frames of different "
                       "exposure or temperature mixed up?")
    fall_dn = -rate_dn_per_s * longest_s
    if fall_dn > FALL_SHARE * white_level_dn:
        raise BadInput(f"the darks get darker with exposure, by {fall_dn:.1f} DN to {longest_s:g} s: no dark current does that",
                       mend="were exposures mixed up, or did the sensor cool down meanwhile? State each frame's exposure_s and "
                       "temperature_c")


def odd_rate(rate_dn_per_s: float, error: float, white_level_dn: float) -> tuple[str, ...]:
    """What has to be said of a mean dark rate that is possible and hardly ever right. error: its 1-sigma uncertainty."""
    if rate_dn_per_s * ODD_TIME_TO_FILL_S > white_level_dn:
        return (f"the dark signal fills the range in {white_level_dn / rate_dn_per_s:.2g} s: light, a hot sensor, or exposures "
                "that are not in seconds",)
    if rate_dn_per_s < -FALLING_SIGMA * error:
        return (f"the dark level falls with exposure ({rate_dn_per_s:.3g} DN/s): a correction on the chip, or a sensor that "
                "cools; this is no dark current",)
    return ()
