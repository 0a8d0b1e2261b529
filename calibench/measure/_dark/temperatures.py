"""The same darks at several temperatures: the law of the dark current, and how many pixels are hot at each (t, T)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .defects import Rules, above_mean_plus_sigma, hot_by_level
from .ladder import Ladder
from .thermal import Activation, activation

WITHOUT = "needs darks of two exposures or more at each of two temperatures"
TOP_SHARE = 0.001  # the hottest pixels, whose own law is shown beside that of all


@dataclass(frozen=True, kw_only=True)
class Temperatures:
    """law: of the mean dark current, or None with `why_not`. layers: scalar layers for the map."""

    law: Activation | None
    why_not: str
    layers: dict[str, float] = field(default_factory=dict)
    evidence: dict[str, np.ndarray] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def over_temperature(ladders: Sequence[Ladder], reference: Ladder, rules: Rules) -> Temperatures:
    """What the temperatures show. `reference` is the ladder whose layers go into the map."""
    layers = {} if reference.temperature_c is None else {"dark_reference_c": reference.temperature_c}
    if reference.rate_dn_per_s is None:
        layers = {}
    rated = [one for one in ladders if one.level_rate is not None and one.temperature_c is not None]
    evidence = _counts(ladders, rules)
    celsius = np.array([one.temperature_c for one in rated])
    if len(rated) < 2 or reference not in rated:
        said = ("darks of several temperatures, but without a law for the dark current: the map holds those of "
                f"{reference.temperature_c:.1f} C only",) if len(ladders) > 1 else ()
        return Temperatures(law=None, why_not=WITHOUT, layers=layers, evidence=evidence, warnings=said)
    rate, error = np.transpose([one.level_rate for one in rated])
    law = activation(celsius, rate, error, reference.temperature_c)
    hot = _hottest(reference)
    hot_rate = np.array([float(np.median(one.rate_dn_per_s[hot])) for one in rated])
    hot_error = np.array([np.sqrt(float(np.median(one.rate_variance[hot])) / np.count_nonzero(hot)) for one in rated])
    evidence |= {"temperature_c": celsius, "temperature_rate_dn_per_s": rate, "temperature_rate_uncertainty_dn_per_s": error,
                 "temperature_hot_rate_dn_per_s": hot_rate}
    if law is None:
        return Temperatures(law=None, why_not="the dark current does not grow with the temperature beyond its errors",
                            layers=layers, evidence=evidence, warnings=(
                                "the dark current shows no growth with the temperature: the map holds it at "
                                f"{reference.temperature_c:.1f} C only",))
    of_hot = activation(celsius, hot_rate, hot_error, reference.temperature_c)
    evidence["temperature_law"] = np.array([law.rate, law.energy_ev, law.reference_c])
    evidence["temperature_hot_law"] = np.array([of_hot.rate, of_hot.energy_ev, of_hot.reference_c] if of_hot else [])
    return Temperatures(law=law, why_not="", layers=layers | {"dark_activation_ev": law.energy_ev}, evidence=evidence)


def _hottest(ladder: Ladder) -> np.ndarray:
    rate = ladder.rate_dn_per_s
    return rate >= np.partition(rate, -max(1, int(TOP_SHARE * rate.size)), axis=None)[-max(1, int(TOP_SHARE * rate.size))]


def _counts(ladders: Sequence[Ladder], rules: Rules) -> dict[str, np.ndarray]:
    """Hot pixels at each exposure and temperature, by the absolute limit and by the thesis rule."""
    rows = []
    everywhere = np.ones(ladders[0].offset_dn.shape, bool)
    for ladder in ladders:
        hot = hot_by_level(ladder, rules)
        rows += [(np.nan if level.exposure_s is None else level.exposure_s,
                  np.nan if level.temperature_c is None else level.temperature_c, count,
                  np.count_nonzero(above_mean_plus_sigma(level.mean_dn, everywhere)))
                 for level, count in zip(ladder.levels, hot, strict=True)]
    return dict(zip(("count_exposure_s", "count_temperature_c", "count_hot", "count_thesis"), np.transpose(rows), strict=True))
