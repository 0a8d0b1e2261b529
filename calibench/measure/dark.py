"""Dark frames over a ladder of exposures: offset, dark rate, read noise, nonuniformity, and the pixels that stand out.

1. Each frame is checked for being dark, then added to the stack of its exposure (one pass, exact sums).
2. Per pixel: offset and rate by least squares over the exposures, with errors from the temporal variance.
3. Defects: rate above the local median (hot, warm), pinned values (stuck), excess temporal variance (noisy), and the
   thesis rule (mean + 5 sigma of the averaged frame) for comparison.
Without exposure times, offset and defects are made all the same, by level, and said to be 'exposure unknown'.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..records import CalibrationMap, Frame, Measurement, Quantity
from . import _defects as defect
from . import _nonuniformity as spatial
from ._darkness import check_dark
from ._gain import known_gain
from ._ladder import QUANTISATION_DN2, Ladder, fit
from ._ledger import Ledger
from ._stack import Accumulator, Series

THESIS_SIGMA = 5.0
FLOOR_VARIANCE_DN2 = 0.24  # EMVA 1288: below it quantisation hides the noise, and sigma_y.dark = 0.49 DN is an upper limit


@dataclass(frozen=True, kw_only=True)
class Settings:
    """hot_rate_per_s: e-/s above the local median from which a significant pixel is hot (DN/s where the gain is unknown).
    hot_level: the same as a share of the range, where no exposure is known. false_alarms: normal pixels a frame that may
    pass. noise_factor: a noisy pixel has at least this many times the typical temporal noise.
    """

    hot_rate_per_s: float = 20.0
    hot_level: float = 0.05
    false_alarms: float = 0.5
    noise_factor: float = 2.0


def measure(frames: Iterable[Frame], settings: Settings | None = None, calmap: CalibrationMap | None = None) -> Measurement:
    """Dark layers and figures.

    Args:
        frames: darks of one camera setting, any exposures, any order. calmap: a map whose gain turns DN into e-.

    Raises:
        BadInput: no frames, mixed settings, a frame that is not dark (named), absurd exposures or rates.
    """
    settings = settings or Settings()
    ledger, stacks = _collect(frames, settings)
    first = ledger.first
    gain = known_gain(calmap, first)
    ladder = fit(stacks, first.white_level_dn, gain.dn_per_e)
    quiet = _quiet(ladder)
    masks, evidence = _defects(ladder, quiet, first, gain.dn_per_e, settings)
    h, w = first.data.shape
    maps = {"offset_dn": ladder.offset_dn, "offset_uncertainty_dn": np.sqrt(ladder.offset_variance_dn2),
            "defects": defect.flags((h, w), **masks)}
    if ladder.rate_dn_per_s is not None:
        maps |= {"dark_rate_dn_per_s": ladder.rate_dn_per_s, "dark_rate_uncertainty_dn_per_s": np.sqrt(ladder.rate_variance)}
    if quiet is not None:
        maps["read_noise_dn"] = _read_noise_map(quiet, masks["noisy"])
    return Measurement(
        name="dark", image_size_px=(w, h), maps=maps, evidence=evidence, provenance=ledger.provenance(),
        quantities=_quantities(ladder, quiet, gain), warnings=_warnings(ledger, ladder),
        frames_used=sum(s.stack.count for s in ladder.series), frames_rejected=tuple(ledger.rejected))


def _collect(frames: Iterable[Frame], settings: Settings) -> tuple[Ledger, dict[float | None, Accumulator]]:
    """One pass: checks, and a stack for each exposure. Frames without exposure are left out where others have one."""
    ledger, stacks, without = Ledger(settings, "dark frames"), {}, []
    for frame in frames:
        check_dark(frame)
        if not ledger.take(frame):
            continue
        stacks.setdefault(frame.exposure_s, Accumulator()).add(frame)
        if frame.exposure_s is None:
            without.append(frame)
    if None in stacks and len(stacks) > 1:
        del stacks[None]
        for frame in without:
            ledger.reject(frame, "no exposure time, while other frames have one")
    ledger.first  # noqa: B018  raises where there was no frame at all
    return ledger, stacks


def _quiet(ladder: Ladder) -> Series | None:
    """The shortest exposure with two frames or more: where the read noise is read."""
    return next((s for s in ladder.series if s.stack.count > 1), None)


def _defects(ladder: Ladder, quiet: Series | None, first: Frame, gain_dn_per_e: float,
             settings: Settings) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Masks by defect class, and the evidence: hot pixel list, thesis counts, levels."""
    white, bayer = first.white_level_dn, first.bayer_pattern
    unit = gain_dn_per_e if np.isfinite(gain_dn_per_e) else 1.0
    frames = sum(s.stack.count for s in ladder.series)
    if ladder.rate_dn_per_s is not None:
        value, variance, limit = ladder.rate_dn_per_s, ladder.rate_variance, settings.hot_rate_per_s * unit
        floor = QUANTISATION_DN2 / frames / max(ladder.exposure_s) ** 2
    else:  # one exposure, known or not: the excess over the neighbours is taken as dark signal
        value, variance = ladder.offset_dn, ladder.offset_variance_dn2
        limit = settings.hot_rate_per_s * unit * ladder.exposure_s[0] if ladder.exposure_s else settings.hot_level * white
        floor = QUANTISATION_DN2 / frames
    deviation = value - defect.background(value, bayer)
    z = defect.significance(deviation, variance, bayer, floor)
    significant = z > defect.threshold(z.size, settings.false_alarms)
    hot = significant & (deviation > limit)
    means = [s.stack.mean_dn for s in ladder.series]
    stuck = _stuck(ladder, white, hot, settings)
    thesis = [_above_thesis_limit(mean, ~stuck) for mean in means]
    masks = {"hot": hot, "warm": significant & ~hot, "hot_thesis": thesis[-1], "stuck": stuck, "noisy": np.zeros_like(hot)}
    if quiet is not None:
        masks["noisy"] = defect.noisy(quiet.steady_variance_dn2, quiet.freedom, settings.false_alarms, settings.noise_factor)
    rows, columns = np.nonzero(hot)
    per_s = "_per_s" if ladder.rate_dn_per_s is not None else ""
    evidence = {
        "hot_xy_px": np.stack([columns, rows], -1), f"hot_excess_dn{per_s}": deviation[hot], "hot_z": z[hot],
        "hot_thesis_count": np.array([int(m.sum()) for m in thesis]),
        "frame_count": np.array([s.stack.count for s in ladder.series]),
        "exposure_s": np.array(ladder.exposure_s or (np.nan,)),
        "mean_level_dn": np.array([m.mean() for m in means]),
        "level_sd_dn": np.array([np.std(s.levels_dn) for s in ladder.series]),
        "temporal_variance_dn2": np.array([float(np.mean(v)) for v in ladder.variance_dn2]),
        "levels_dn": np.concatenate([s.levels_dn for s in ladder.series])}
    return masks, evidence


def _above_thesis_limit(mean: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """The thesis rule: above mean + 5 sigma of the averaged frame. Stuck pixels are not counted in, a few would blind it."""
    return counted & (mean > mean[counted].mean() + THESIS_SIGMA * mean[counted].std())


def _stuck(ladder: Ladder, white_dn: float, hot: np.ndarray, settings: Settings) -> np.ndarray:
    """Pinned at the top in every frame, never changing where noise would, or a high offset that no dark rate explains."""
    means = [s.stack.mean_dn for s in ladder.series]
    count = sum(s.stack.count for s in ladder.series)
    at_top = np.all([m >= white_dn for m in means], axis=0)
    total = sum(np.nan_to_num(s.stack.variance_dn2) for s in ladder.series) + np.ptp(means, axis=0)
    frozen = defect.never_changing(total, count) if ladder.noise_known else np.zeros_like(hot)
    if ladder.rate_dn_per_s is None:
        return at_top | frozen
    high = ladder.offset_dn - defect.background(ladder.offset_dn, None) > settings.hot_level * white_dn
    return at_top | frozen | (high & ~hot)


def _read_noise_map(quiet: Series, noisy: np.ndarray) -> np.ndarray:
    """Temporal noise (H, W) at the shortest exposure, DN, with quantisation.

    A few frames tell little of one pixel: its variance is drawn towards the typical one as far as the scatter of the
    variances is chance (James and Stein 1961); a noisy pixel keeps its own.
    """
    variance = quiet.steady_variance_dn2
    typical = float(np.median(variance))
    low, high = np.percentile(variance, (15.87, 84.13))
    chance = 2 * typical**2 / quiet.freedom
    real = max(((high - low) / 2) ** 2 - chance, 0.0)
    share = real / (real + chance) if chance > 0 else 1.0
    mean = float(np.mean(variance[~noisy])) if not noisy.all() else typical
    return np.sqrt(np.where(noisy, variance, mean + share * (variance - mean)))


def _quantities(ladder: Ladder, quiet: Series | None, gain: object) -> tuple[Quantity, ...]:
    out = [Quantity(name="offset_dn", value=ladder.level_offset[0], uncertainty=ladder.level_offset[1], unit="DN",
                    symbol="mu_y.dark", source="dark ladder at zero exposure" if ladder.level_rate else "mean dark level; "
                    "dark signal not separated from it")]
    out += _read_noise(quiet, gain)
    reason = "" if ladder.level_rate else ("exposure unknown" if ladder.exposure_s is None else "one exposure only")
    value, error = ladder.level_rate or (None, None)
    out += gain.both("dark_rate_dn_per_s", "dark_current_e_per_s", value, error, "DN/s", "e-/s", symbol="mu_I",
                     source="slope of the mean dark level over exposure, EMVA 1288 R4 Linear, dark current", reason=reason)
    most = max(range(len(ladder.series)), key=lambda i: ladder.series[i].stack.count)  # the first, so the shortest, of equals
    at = ladder.series[most]
    temporal = float(np.mean(ladder.variance_dn2[most])) / at.stack.count
    when = f"at {ladder.exposure_s[most]:g} s" if ladder.exposure_s else "exposure unknown"
    for kind, function, text in (("raw", spatial.spatial_raw, "no high-pass, all pixels"),
                                 ("1288", spatial.spatial_1288, "EMVA 1288 R4 Linear 8, high-passed, all pixels"),
                                 ("core", spatial.spatial_core, "high-passed, interquartile range")):
        if not ladder.noise_known:
            out += gain.both(f"dsnu_{kind}_dn", f"dsnu_{kind}_e", None, None, "DN", "e-", symbol="DSNU",
                             source=text, reason="one frame only: temporal noise unknown")
            continue
        found = function(at.stack.mean_dn, temporal)
        note = "" if found.signed_variance >= 0 else f"negative variance estimate {found.signed_variance:.3g} DN^2, given as 0"
        out += gain.both(f"dsnu_{kind}_dn", f"dsnu_{kind}_e", found.sd, found.uncertainty, "DN", "e-", symbol="DSNU",
                         source=f"{text}; {when}", reason=note)
    return tuple(out)


def _read_noise(quiet: Series | None, gain: object) -> list[Quantity]:
    """EMVA sigma_d at the shortest exposure with two frames or more."""
    source = "EMVA 1288 R4 Linear: sigma_d, shortest exposure, quantisation variance 1/12 DN^2 subtracted"
    if quiet is None:
        return gain.both("read_noise_dn", "read_noise_e", None, None, "DN", "e-", symbol="sigma_d", source=source,
                         reason="needs two frames of one exposure")
    variance = float(np.mean(quiet.steady_variance_dn2))
    note = ""
    if variance < FLOOR_VARIANCE_DN2:
        note = f"temporal variance {variance:.3g} DN^2 is below 0.24: an upper limit, quantisation hides the noise"
        variance = 0.49**2
    sd = float(np.sqrt(variance - QUANTISATION_DN2))
    error = variance * np.sqrt(2 / (quiet.freedom * quiet.steady_variance_dn2.size)) / (2 * sd)
    return gain.both("read_noise_dn", "read_noise_e", sd, error, "DN", "e-", symbol="sigma_d", source=source, reason=note)


def _warnings(ledger: Ledger, ladder: Ladder) -> tuple[str, ...]:
    out = list(ledger.warnings)
    if ledger.first.bit_depth <= 8:
        out.append("8-bit darks: quantisation hides the read noise and weak defects")
    if ladder.exposure_s is None:
        out.append("exposure unknown: no dark rate; offset and defects hold for frames taken like these only")
    elif ladder.rate_dn_per_s is None:
        out.append(f"one exposure only ({ladder.exposure_s[0]:g} s): offset includes the dark signal, no dark rate")
    if not ladder.noise_known:
        out.append("one frame an exposure: temporal noise unknown, defects judged by the scatter over the image")
    for series, t in zip(ladder.series, ladder.exposure_s or (None,), strict=True):
        low, high = series.levels_dn.min(), series.levels_dn.max()
        if high - low > max(0.5, 0.25 * float(np.sqrt(np.median(ladder.variance_dn2[0])))):
            which = "frames" if t is None else f"frames of {t:g} s"
            out.append(f"the level drifts from {low:.1f} to {high:.1f} DN over the {which}")
    return tuple(out)
