"""Dark frames over a ladder of exposures: offset, dark rate, read noise, nonuniformity, and the pixels that stand out.

1. Each frame is checked for being dark, then added to the stack of its exposure and temperature (one pass, exact sums).
2. Per pixel, at the temperature with most exposures (the warmest of equals): offset and rate by least squares, with errors
   from the temporal variance.
3. Dark current against temperature, where the frames have several.
4. Defects: `_dark_defects`; a second pass over the frames looks at the unsteady pixels frame by frame.
Without exposure times, offset and defects are made all the same, by level, and said to be 'exposure unknown'.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..calmap.clusters import with_clusters
from ..records import CalibrationMap, Frame, Measurement, Provenance
from ._dark import telegraph
from ._dark.darkness import check_dark, check_light, high_level
from ._dark.defects import Fetch, Found, Rules, find_defects
from ._dark.figures import quantities, read_noise_map
from ._dark.ladder import Ladder, fit
from ._dark.levels import DarkLevel, DarkLevels
from ._dark.limits import odd_rate
from ._dark.temperatures import Temperatures, over_temperature
from ._defects import flags, typical
from ._frames.ledger import TEMPERATURE_DRIFT_C, Ledger
from ._gain import Gain, known_gain
from ._since import with_changes

NOT_AGAIN = "the frames cannot be read a second time: telegraph pixels and hits were not looked for"


@dataclass(frozen=True, kw_only=True)
class Settings:
    """hot_rate_per_s: e-/s above the local median from which a significant pixel is hot (DN/s where the gain is unknown).
    hot_level: the same as a share of the range, where no exposure is known. false_alarms: normal pixels a frame that may
    pass. noise_factor: a noisy pixel has at least this many times the typical temporal noise. nonlinear: a nonlinear pixel
    departs from its line by at least this share of its dark signal.
    """

    hot_rate_per_s: float = 20.0
    hot_level: float = 0.05
    false_alarms: float = 0.5
    noise_factor: float = 2.0
    nonlinear: float = 0.1


def measure(frames: Iterable[Frame], settings: Settings | None = None, calmap: CalibrationMap | None = None) -> Measurement:
    """Dark layers and figures.

    Args:
        frames: darks of one camera setting, any exposures and temperatures, any order; read a second time where they can be.
        calmap: a map whose gain turns DN into e-; where it holds the darks of another session, its defects are compared.

    Raises:
        BadInput: no frames, mixed settings, a frame that is not dark (named), darks as evenly lit as light
            makes them, absurd exposures or rates.
    """
    settings = settings or Settings()
    ledger, groups = _collect(frames, settings)
    first = ledger.first
    gain = known_gain(calmap, first)
    ladders = [fit(levels, first.white_level_dn, gain.dn_per_e) for levels in groups]
    ladder = max(ladders, key=lambda one: (len(one.levels), sum(level.count for level in one.levels), one.temperature_c or 0.0))
    if ladder.level_rate is not None:
        check_light(ladder.level_rate[0] * ladder.exposure_s[-1], first.white_level_dn, lambda: ladder.rate_dn_per_s,
                    first.bayer_pattern)
    quiet = next((level for level in ladder.levels if level.freedom), None)
    unit = gain.dn_per_e if np.isfinite(gain.dn_per_e) else 1.0
    rules = _rules(ladder, first, gain, settings, unit)
    refused: list[str] = []
    found = find_defects(ladder, quiet, rules, _fetcher(frames, ledger, refused))
    warm = over_temperature(ladders, ladder, rules)
    # before the maps are made: with the images it needs they would be the most that is held at a time
    figures = quantities(ladder, quiet, gain, found, (warm.law, warm.why_not), settings.false_alarms)
    h, w = first.data.shape
    maps = {} if quiet is None else {"read_noise_dn": read_noise_map(quiet, found.masks["noisy"])}
    maps["defects"] = with_clusters(flags((h, w), **found.masks))
    found = replace(found, masks={})  # they are in the flags now, in a fifth of the memory
    maps |= {"offset_dn": ladder.offset_dn, "offset_uncertainty_dn": _root(ladder.offset_variance_dn2)}
    if ladder.rate_dn_per_s is not None:
        maps |= {"dark_rate_dn_per_s": ladder.rate_dn_per_s, "dark_rate_uncertainty_dn_per_s": _root(ladder.rate_variance)}
    measured = Measurement(
        name="dark", image_size_px=(w, h), maps=maps, layers=warm.layers, provenance=_provenance(ledger, ladder, warm),
        evidence=_evidence(ladder) | found.evidence | warm.evidence,
        quantities=figures,
        warnings=(*_warnings(ledger, ladder, len(groups)), *warm.warnings, *refused,
                  *_blind(found, ladder, unit, settings, np.isfinite(gain.dn_per_e))),
        frames_used=sum(level.count for levels in groups for level in levels), frames_rejected=tuple(ledger.rejected))
    return with_changes(measured, calmap, ("hot", "stuck", "noisy", "telegraph"), "offset_dn")


def _root(variance: np.ndarray) -> np.ndarray:
    return np.sqrt(variance, out=variance)


def _collect(frames: Iterable[Frame], settings: Settings) -> tuple[Ledger, list[list[DarkLevel]]]:
    """One pass: checks, and the levels of each temperature. Frames without exposure are left out where others have one."""
    ledger, levels, without = Ledger(settings, "dark frames"), DarkLevels(), []
    for frame in frames:
        check_dark(frame)
        if not ledger.take(frame):
            continue
        levels.add(frame)
        if frame.exposure_s is None:
            without.append(frame.file or frame.name)
    ledger.first  # noqa: B018  raises where there was no frame at all
    groups, dropped = levels.groups()
    if dropped:
        ledger.rejected += [(name, "no exposure time, while other frames have one") for name in without]
    return ledger, groups


def _fetcher(frames: Iterable[Frame], ledger: Ledger, refused: list[str]) -> Fetch:
    """How to look at pixels of a level again; says in `refused` where that is impossible."""
    rejected = {name for name, _ in ledger.rejected}

    def fetch(levels: Sequence[DarkLevel], xy_px: Sequence[np.ndarray]) -> list[telegraph.TimeSeries] | None:
        sorter, number = DarkLevels(), {(level.exposure_s, level.group): i for i, level in enumerate(levels)}

        def level_of(frame: Frame) -> int | None:
            return None if (frame.file or frame.name) in rejected else number.get(sorter.key(frame))

        series = None if iter(frames) is frames else telegraph.fetch(frames, level_of, [v.levels_dn for v in levels], xy_px)
        if series is None:
            refused.append(NOT_AGAIN)
        return series
    return fetch


def _rules(ladder: Ladder, first: Frame, gain: Gain, settings: Settings, unit: float) -> Rules:
    white = first.white_level_dn
    limit = settings.hot_rate_per_s * unit
    if ladder.rate_dn_per_s is None:  # one exposure, known or not: the excess over the neighbours is taken as dark signal
        limit = limit * ladder.exposure_s[0] if ladder.exposure_s else settings.hot_level * white
    return Rules(limit=limit, hot_level=settings.hot_level, false_alarms=settings.false_alarms,
                 noise_factor=settings.noise_factor, nonlinear=settings.nonlinear, dn_per_e=gain.dn_per_e, white_dn=white,
                 bayer_pattern=first.bayer_pattern)


def _evidence(ladder: Ladder) -> dict[str, np.ndarray]:
    levels = ladder.levels
    return {"frame_count": np.array([level.count for level in levels]),
            "exposure_s": np.array(ladder.exposure_s or (np.nan,)),
            "mean_level_dn": np.array([level.levels_dn.mean() for level in levels]),
            "level_sd_dn": np.array([np.std(level.levels_dn) for level in levels]),
            "temporal_variance_dn2": np.array([float(np.mean(v)) for v in ladder.variance_dn2]),
            "levels_dn": np.concatenate([level.levels_dn for level in levels])}


def _provenance(ledger: Ledger, ladder: Ladder, warm: Temperatures) -> Provenance:
    """Without a law of the temperature the dark layers hold at the reference alone, whatever other frames there were."""
    provenance = ledger.provenance()
    celsius = [c for level in ladder.levels for c in level.celsius]
    if warm.law is not None or not celsius:
        return provenance
    return replace(provenance, conditions=provenance.conditions | {"temperature_c": (min(celsius), max(celsius))})


def _blind(found: Found, ladder: Ladder, unit: float, settings: Settings, in_electrons: bool) -> tuple[str, ...]:
    """Where the search cannot see what it is asked for, this is said: a low count would look like a good sensor."""
    limit = found.detection_limit[0] / unit
    if ladder.rate_dn_per_s is None:
        return ()
    e = "e-/s" if in_electrons else "DN/s"
    classed = () if in_electrons else (f"gain unknown: a pixel is hot from {settings.hot_rate_per_s:g} DN/s above its "
                                       "neighbours on; with a map that holds the gain (--map) the limit is in e-/s",)
    if limit <= settings.hot_rate_per_s:
        return classed
    return (*classed, f"hot pixels are found reliably (99 %) only from {limit:.3g} {e} above their neighbours on, the limit is "
            f"{settings.hot_rate_per_s:g} {e}: weaker ones may be missing; take longer darks or more of them",)


def _warnings(ledger: Ledger, ladder: Ladder, temperatures: int) -> tuple[str, ...]:
    out = [w for w in ledger.warnings if temperatures == 1 or not w.startswith("temperature drifted")]
    out += high_level(float(ladder.levels[-1].levels_dn.mean()), ledger.first.white_level_dn)
    if temperatures > 1:
        spans = [(min(level.celsius), max(level.celsius)) for level in ladder.levels if level.celsius]
        out += [f"temperature drifted from {low:.1f} to {high:.1f} C over the frames of one exposure"
                for low, high in spans if high - low > TEMPERATURE_DRIFT_C]
    if ledger.first.bit_depth <= 8:
        out.append("8-bit darks: quantisation hides the read noise and weak defects")
    if ladder.exposure_s is None:
        out.append("exposure unknown: no dark rate; offset and defects hold for frames taken like these only")
    elif ladder.rate_dn_per_s is None:
        out.append(f"one exposure only ({ladder.exposure_s[0]:g} s): offset includes the dark signal, no dark rate")
    if ladder.level_rate is not None:
        out += odd_rate(*ladder.level_rate, ledger.first.white_level_dn)
    single = [t for level, t in zip(ladder.levels, ladder.exposure_s or (0.0,), strict=True) if not level.freedom]
    if not ladder.noise_known:
        out.append("one frame an exposure: temporal noise unknown, defects judged by the scatter over the image")
    elif single:
        out.append(f"one frame only of {', '.join(f'{t:g} s' for t in single)}: no temporal noise of its own, that of "
                   f"{next(t for t in ladder.exposure_s if t not in single):g} s is taken")
    for level, t in zip(ladder.levels, ladder.exposure_s or (None,), strict=True):
        low, high = level.levels_dn.min(), level.levels_dn.max()
        if high - low > max(0.5, 0.25 * float(np.sqrt(typical(ladder.variance_dn2[0])))):
            which = "frames" if t is None else f"frames of {t:g} s"
            out.append(f"the level drifts from {low:.1f} to {high:.1f} DN over the {which}")
    return tuple(out)
