"""Defects of the dark: which pixels are hot, warm, stuck, noisy, telegraph or nonlinear, and which rows and columns.

1. Deviation of the dark rate from the local level, in units of the local scale; threshold from the null (`_null`).
2. Candidates of telegraph noise and of hits by particles are looked at again, frame by frame (`_telegraph`).
3. [T]'s rule (above mean + 5 sigma of the averaged frame) stands beside it, as `hot_thesis`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtri

from .. import _defects as defect
from . import telegraph
from .ladder import Ladder
from .levels import DarkLevel
from .limits import QUANTISATION_DN2
from .null import Null, fit_null

THESIS_SIGMA = 5.0
FOUND_SHARE = 0.99  # the detection limit is the excess that is found with this probability
NULL_SAMPLE = 1_000_000  # pixels from which a null is learned
EXAMPLES = 6

Fetch = Callable[[Sequence[DarkLevel], Sequence[np.ndarray]], "list[telegraph.TimeSeries] | None"]


@dataclass(frozen=True, kw_only=True)
class Rules:
    """limit: excess from which a significant pixel is hot, in the unit of the map that is judged; the others as in
    `dark.Settings`. dn_per_e: NaN where unknown. white_dn: the converter's end."""

    limit: float
    hot_level: float
    false_alarms: float
    noise_factor: float
    nonlinear: float
    dn_per_e: float
    white_dn: float
    bayer_pattern: str | None


@dataclass(frozen=True, kw_only=True)
class Found:
    """masks: (H, W) bool by flag. detection_limit: (value, spread over the image) of the smallest excess found with
    FOUND_SHARE."""

    masks: dict[str, np.ndarray]
    detection_limit: tuple[float, float]
    evidence: dict[str, np.ndarray] = field(default_factory=dict)


def find_defects(ladder: Ladder, quiet: DarkLevel | None, rules: Rules, fetch: Fetch) -> Found:
    """Masks by class with their evidence.

    Args:
        quiet: the shortest exposure with two frames or more. fetch: for each level the time series of its pixels
            (P, 2), by one second pass over the frames; None where the frames cannot be read again.
    """
    known = ladder.rate_dn_per_s is not None
    value = ladder.rate_dn_per_s if known else ladder.offset_dn
    frames = sum(level.count for level in ladder.levels)
    floor = QUANTISATION_DN2 / frames / (max(ladder.exposure_s) ** 2 if known else 1.0)
    deviation = value - defect.background(value, rules.bayer_pattern)
    variance = ladder.rate_variance if known else ladder.offset_variance_dn2
    scale = defect.scale(deviation, variance, rules.bayer_pattern, floor)
    z = deviation / scale
    null = fit_null(_sample(z))
    threshold = null.threshold(z.size, rules.false_alarms)
    detection_limit = _detection_limit(scale, null, threshold, ladder, rules)
    del scale, variance
    significant = z > threshold
    hot = significant & (deviation > rules.limit)
    hot_at, hot_z = hot, z[hot]
    counts, edges = _histogram(z)
    del z
    noisy = _noisy(ladder, quiet, deviation, rules)
    offset_local = defect.background(ladder.offset_dn, rules.bayer_pattern) if known else value - deviation
    stuck = _stuck(ladder, offset_local, hot, rules)
    unsteady, evidence = _unsteady(ladder, significant & ~stuck, (offset_local, deviation), fetch)
    del offset_local
    noisy |= unsteady["hit"]
    hot = hot & ~unsteady["hit"]
    masks = {"hot": hot, "warm": significant & ~hot & ~unsteady["hit"], "stuck": stuck, "noisy": noisy,
             "telegraph": unsteady["telegraph"] & ~stuck, "nonlinear": _nonlinear(ladder, rules) & ~stuck}
    thesis = []
    for level in ladder.levels:
        masks["hot_thesis"] = above_mean_plus_sigma(level.mean_dn, ~stuck)
        thesis.append(int(masks["hot_thesis"].sum()))
    masks["row"], masks["column"] = _lines(masks, ladder, rules)
    per_s = "_per_s" if known else ""
    rows, columns = np.nonzero(hot)
    evidence |= {
        "hot_xy_px": np.stack([columns, rows], -1), f"hot_excess_dn{per_s}": deviation[hot], "hot_z": hot_z[hot[hot_at]],
        "hot_thesis_count": np.array(thesis),
        "hot_above_limit_count": hot_by_level(ladder, rules),
        "z_histogram_count": counts, "z_histogram_edge": edges,
        "z_null": np.array([null.centre, null.scale, null.g, null.h, threshold])}
    return Found(masks=masks, evidence=evidence, detection_limit=detection_limit)


def above_mean_plus_sigma(mean: np.ndarray, counted: np.ndarray, k_sigma: float = THESIS_SIGMA) -> np.ndarray:
    """The thesis rule: above mean + k sigma of the averaged frame. Stuck pixels are not counted in, a few would blind it."""
    values = mean[counted]
    return counted & (mean > float(values.mean() + k_sigma * values.std()))


def _sample(z: np.ndarray) -> np.ndarray:
    return z.reshape(-1)[:: max(1, z.size // NULL_SAMPLE)]


def _detection_limit(scale: np.ndarray, null: Null, threshold: float, ladder: Ladder, rules: Rules) -> tuple[float, float]:
    """Smallest excess found with FOUND_SHARE: it has to lift even a pixel at the null's low end over the threshold. Its own
    shot noise lowers its significance (left out where the gain is unknown). With its 1-sigma spread over the image."""
    low, typical, high = np.percentile(scale.reshape(-1)[:: max(1, scale.size // NULL_SAMPLE)], (15.87, 50, 84.13))
    margin = float(threshold - null.quantile(-ndtri(FOUND_SHARE)))
    shot = 0.0
    if np.isfinite(rules.dn_per_e) and ladder.to_rate is not None:
        per_frame = np.array(ladder.exposure_s) / [level.count for level in ladder.levels]
        shot = rules.dn_per_e * float(ladder.to_rate**2 @ per_frame)
    # excess = margin * sqrt(typical^2 + shot * excess)
    limit = (margin**2 * shot + np.sqrt(margin**4 * shot**2 + 4 * margin**2 * typical**2)) / 2
    return float(limit), float(limit * (high - low) / (2 * typical))


def _stuck(ladder: Ladder, offset_local: np.ndarray, hot: np.ndarray, rules: Rules) -> np.ndarray:
    """Pinned at the top in every frame, never changing where noise would, or a high offset that no dark rate explains."""
    levels = ladder.levels
    first = levels[0].mean_dn
    stuck, bits = first >= rules.white_dn, levels[0].constant
    for level in levels[1:]:
        stuck &= level.mean_dn >= rules.white_dn
        bits = bits & level.constant & np.packbits(level.mean_dn == first)
    if ladder.noise_known:
        same = np.unpackbits(bits, count=first.size).view(bool).reshape(first.shape)
        stuck |= defect.never_changing(same, defect.typical(ladder.variance_dn2[0]), sum(level.count for level in levels))
    if ladder.rate_dn_per_s is not None:
        high = ladder.offset_dn - offset_local > rules.hot_level * rules.white_dn
        stuck |= high & ~hot
    return stuck


def _noisy(ladder: Ladder, quiet: DarkLevel | None, deviation: np.ndarray, rules: Rules) -> np.ndarray:
    """Too much temporal noise at the shortest exposure; at the longest too, beyond a hot pixel's shot noise, where the gain is
    known: so a hit by a particle or an unsteady dark current shows."""
    if quiet is None:
        return np.zeros(deviation.shape, bool)
    by = {"expected": rules.false_alarms, "factor": rules.noise_factor}
    noisy = defect.noisy(quiet.variance_dn2, quiet.freedom, **by)
    longest = ladder.levels[-1]
    if ladder.rate_dn_per_s is not None and longest.freedom and np.isfinite(rules.dn_per_e):
        typical = defect.typical_noise(longest.variance_dn2, longest.freedom)
        dark_dn = np.maximum(deviation, 0) * np.float32(longest.exposure_s)
        steady = longest.variance_dn2 * np.float32(typical) / (np.float32(typical) + np.float32(rules.dn_per_e) * dark_dn)
        noisy |= defect.noisy(steady, longest.freedom, **by)
    return noisy


def _unsteady(ladder: Ladder, significant: np.ndarray, local: tuple[np.ndarray, np.ndarray], fetch: Fetch) -> tuple[dict, dict]:
    """Telegraph pixels, and hits: significant pixels that most frames do not confirm. Telegraph signals are looked for where
    there are most frames and at the longest exposure, hits at the longest, where they count most.

    local: level of the offset around each pixel, and deviation of its rate from the rates around.
    """
    masks = {"telegraph": np.zeros_like(significant), "hit": np.zeros_like(significant)}
    evidence: dict[str, np.ndarray] = {}
    levels = list(zip(ladder.levels, ladder.variance_dn2, strict=True))
    watched = {id(level): (level, variance) for level, variance in (
        max(reversed(levels), key=lambda v: v[0].count), levels[-1])}
    looks = []
    for level, variance in watched.values():
        if level.freedom >= 2:
            typical = defect.typical_noise(variance, level.freedom)
            xy_px = telegraph.candidates(variance, level.freedom, typical, significant)
            looks += [(level, typical, xy_px)] if len(xy_px) else []
    found = fetch([level for level, *_ in looks], [xy_px for *_, xy_px in looks]) if looks else None
    for (level, typical, _), series in zip(looks, found, strict=True) if found else ():
        x, y = series.xy_px.T
        at = local[0][y, x]
        if ladder.rate_dn_per_s is not None:
            at = at + (ladder.rate_dn_per_s[y, x] - local[1][y, x]) * level.exposure_s
        longest = level is ladder.levels[-1]
        unconfirmed = significant[y, x] & longest & ~telegraph.confirmed(series.values_dn, at, typical)
        jumping, step, duty = telegraph.two_levels(series.values_dn)
        masks["hit"][y[unconfirmed], x[unconfirmed]] = True
        masks["telegraph"][y[jumping], x[jumping]] = True
        if jumping.any() or "telegraph_xy_px" not in evidence:
            best = np.flatnonzero(jumping)[np.argsort(-step[jumping])]
            evidence |= {"telegraph_xy_px": series.xy_px[best], "telegraph_step_dn": step[best], "telegraph_duty": duty[best],
                         "telegraph_series_dn": series.values_dn[:, best[:EXAMPLES]].T}
    return masks, evidence


def _nonlinear(ladder: Ladder, rules: Rules) -> np.ndarray:
    """Pixels whose level departs from their own line at some exposure: significantly, by a share of their dark signal there,
    and by more than the noise of one frame."""
    found = np.zeros(ladder.offset_dn.shape, bool)
    if ladder.rate_dn_per_s is None or len(ladder.levels) < 3:
        return found
    noise = np.float32(np.sqrt(defect.typical(ladder.variance_dn2[0])))
    for t, departure, of_frame, count in ladder.departures():
        matters = np.abs(ladder.rate_dn_per_s)
        matters *= np.float32(t * rules.nonlinear)
        np.maximum(matters, noise, out=matters)
        departure -= np.float32(defect.typical(departure))  # what all pixels do together is the sensor's, not the pixel's
        chosen = departure > matters
        chosen |= departure < np.negative(matters, out=matters)
        chosen = np.nonzero(chosen)
        spread = 1.4826 * defect.typical(np.abs(_sample(departure)))
        common, floor = np.float32(defect.typical(of_frame)), np.float32(spread**2 + QUANTISATION_DN2)
        sample, chosen_z = (some / np.sqrt(np.maximum(variance - common, 0) / np.float32(count) + floor) for some, variance in (
            (_sample(departure), _sample(of_frame)), (departure[chosen], of_frame[chosen])))
        threshold = fit_null(sample).threshold(departure.size, rules.false_alarms / (2 * len(ladder.levels)))
        found[chosen] |= np.abs(chosen_z) > threshold
    return found


def _lines(masks: dict[str, np.ndarray], ladder: Ladder, rules: Rules) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of defective rows and of defective columns: runs full of defects, and whole lines of too high a dark rate."""
    rows, columns = defect.defective_lines(masks["hot"] | masks["stuck"] | masks["noisy"] | masks["telegraph"])
    if ladder.rate_dn_per_s is not None:
        high_rows, high_columns = defect.lines_above(ladder.rate_dn_per_s, rules.limit)
        rows, columns = rows | high_rows[:, None], columns | high_columns
    return rows, columns


def hot_by_level(ladder: Ladder, rules: Rules) -> np.ndarray:
    """Pixels that the averaged frame of each exposure alone shows: above its median by the limit's charge, and by the Gaussian
    tail of its robust scatter (noise and fixed pattern) that `false_alarms` pixels pass."""
    found = []
    for t, level in zip(ladder.exposure_s or (0.0,), ladder.levels, strict=True):
        k = -ndtri(min(rules.false_alarms / level.mean_dn.size, 0.5))
        middle = defect.typical(level.mean_dn)
        scatter = 1.4826 * defect.typical(np.abs(_sample(level.mean_dn) - middle))
        limit = rules.limit * (t if ladder.rate_dn_per_s is not None else 1.0)
        found.append(int(np.count_nonzero(level.mean_dn > middle + max(limit, k * scatter))))
    return np.array(found)


def _histogram(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Counts of z in steps that show the normal pixels and the tail; the end bins hold what lies beyond."""
    edges = np.concatenate([np.arange(-12, 30, 0.25), np.geomspace(30, 1e4, 40)])
    counts, _ = np.histogram(np.clip(z, edges[0], edges[-1]), edges)
    return counts, edges
