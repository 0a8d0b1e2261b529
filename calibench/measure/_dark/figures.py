"""The figures of the dark: offset, read noise, dark current and its temperature, nonuniformity, what the search can find."""

from __future__ import annotations

import numpy as np

from ...records import Quantity
from .. import _nonuniformity as spatial
from .._gain import Gain
from .._quantiles import quantiles
from .defects import Found
from .ladder import Ladder
from .levels import DarkLevel
from .limits import QUANTISATION_DN2
from .thermal import Activation

FLOOR_VARIANCE_DN2 = 0.24  # EMVA 1288: below it quantisation hides the noise, and sigma_y.dark = 0.49 DN is an upper limit


def read_noise_map(quiet: DarkLevel, noisy: np.ndarray) -> np.ndarray:
    """Temporal noise (H, W) at the shortest exposure, DN, with quantisation.

    A few frames tell little of one pixel: its variance is drawn towards the typical one as far as the scatter of the
    variances is chance (James and Stein 1961); a noisy pixel keeps its own.
    """
    variance = quiet.variance_dn2
    low, middle, high = quantiles(variance, (0.1587, 0.5, 0.8413))
    chance = 2 * middle**2 / quiet.freedom
    real = max(((high - low) / 2) ** 2 - chance, 0.0)
    share = real / (real + chance) if chance > 0 else 1.0
    mean = float(np.mean(variance[~noisy])) if not noisy.all() else float(middle)
    return np.sqrt(np.where(noisy, variance, np.float32(mean) + np.float32(share) * (variance - np.float32(mean))))


def quantities(ladder: Ladder, quiet: DarkLevel | None, gain: Gain, found: Found, warm: tuple[Activation | None, str],
               false_alarms: float) -> tuple[Quantity, ...]:
    """All figures; what is not available has its reason. warm: the law of the temperature, or why there is none."""
    out = [Quantity(name="offset_dn", value=ladder.level_offset[0], uncertainty=ladder.level_offset[1], unit="DN",
                    symbol="mu_y.dark", source="dark ladder at zero exposure" if ladder.level_rate else "mean dark level; "
                    "dark signal not separated from it")]
    out += _read_noise(quiet, gain)
    reason = "" if ladder.level_rate else ("exposure unknown" if ladder.exposure_s is None else "one exposure only")
    value, error = ladder.level_rate or (None, None)
    where = "" if ladder.temperature_c is None else f", at {ladder.temperature_c:.1f} C"
    out += gain.both("dark_rate_dn_per_s", "dark_current_e_per_s", value, error, "DN/s", "e-/s", symbol="mu_I",
                     source=f"slope of the mean dark level over exposure, EMVA 1288 R4 Linear, dark current{where}",
                     reason=reason)
    value, error = found.detection_limit if ladder.level_rate else (None, None)
    out += gain.both("hot_detection_limit_dn_per_s", "hot_detection_limit_e_per_s", value, error, "DN/s", "e-/s",
                     symbol="mu_I.99", reason=reason, source="smallest excess of the dark rate that is found in 99 % of the "
                     "pixels that have it; the uncertainty is its spread over the image")
    out.append(Quantity(name="hot_false_alarms", value=false_alarms, uncertainty=None, unit="1", source="normal pixels of a "
                        "frame expected beyond the threshold, from the tail fitted to the normal pixels",
                        reason="set, not measured"))
    return (*out, *_temperature(*warm), *_dsnu(ladder, gain))


def _temperature(law: Activation | None, why_not: str) -> list[Quantity]:
    source = "Arrhenius law through the mean dark currents of the temperatures"
    values = (None,) * 4 if law is None else (law.energy_ev, law.energy_uncertainty_ev, law.doubling_c,
                                              law.doubling_uncertainty_c)
    at = "" if law is None else f", at {law.reference_c:.1f} C"
    return [Quantity(name="dark_activation_ev", symbol="E_a", unit="eV", value=values[0], uncertainty=values[1], source=source,
                     reason=why_not),
            Quantity(name="dark_doubling_c", symbol="T_d", unit="K", value=values[2], uncertainty=values[3],
                     source=source + at, reason=why_not)]


def _dsnu(ladder: Ladder, gain: Gain) -> list[Quantity]:
    """At the exposure with most frames, the shortest of equals."""
    most = max(range(len(ladder.levels)), key=lambda i: ladder.levels[i].count)
    at, out = ladder.levels[most], []
    temporal = float(np.mean(ladder.variance_dn2[most])) / at.count
    when = f"at {ladder.exposure_s[most]:g} s" if ladder.exposure_s else "exposure unknown"
    by_kind = spatial.of_each_kind(at.mean_dn, temporal) if ladder.noise_known else {}
    for kind, text in spatial.KINDS.items():
        if not ladder.noise_known:
            out += gain.both(f"dsnu_{kind}_dn", f"dsnu_{kind}_e", None, None, "DN", "e-", symbol="DSNU",
                             source=text, reason="one frame only: temporal noise unknown")
            continue
        found = by_kind[kind]
        note = "" if found.signed_variance >= 0 else spatial.NEGATIVE.format(found.signed_variance, "DN^2")
        out += gain.both(f"dsnu_{kind}_dn", f"dsnu_{kind}_e", found.sd, found.uncertainty, "DN", "e-", symbol="DSNU",
                         source=f"{text}; {when}", reason=note)
    return out


def _read_noise(quiet: DarkLevel | None, gain: Gain) -> list[Quantity]:
    """EMVA sigma_d at the shortest exposure with two frames or more."""
    source = "EMVA 1288 R4 Linear: sigma_d, shortest exposure, quantisation variance 1/12 DN^2 subtracted"
    if quiet is None:
        return gain.both("read_noise_dn", "read_noise_e", None, None, "DN", "e-", symbol="sigma_d", source=source,
                         reason="needs two frames of one exposure")
    variance = float(np.mean(quiet.variance_dn2))
    note = ""
    if variance < FLOOR_VARIANCE_DN2:
        note = f"temporal variance {variance:.3g} DN^2 is below 0.24: an upper limit, quantisation hides the noise"
        variance = 0.49**2
    sd = float(np.sqrt(variance - QUANTISATION_DN2))
    error = variance * np.sqrt(2 / (quiet.freedom * quiet.variance_dn2.size)) / (2 * sd)
    return gain.both("read_noise_dn", "read_noise_e", sd, error, "DN", "e-", symbol="sigma_d", source=source, reason=note)
