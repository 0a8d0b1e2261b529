"""Flat frames, minus darks: response separated from illumination, nonuniformity, dead and cold pixels, gain.

1. Darks among the frames (kind 'dark') make a ladder; else the map's dark layers serve; without either: refused.
2. Flats are stacked by exposure and light level; saturated and too dim levels are set aside.
3. The level with most frames around half of the range gives the response: signal / smooth illumination, mean 1.
4. All levels with two frames or more give the gain by photon transfer.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..calmap.clusters import with_clusters
from ..errors import BadInput
from ..records import CalibrationMap, Frame, Measurement, Quantity
from ._dark_levels import DarkLevel, DarkLevels
from ._darkness import check_dark
from ._defects import defective_lines, flags, planes, typical
from ._dust import find_dust
from ._flat_figures import NEED_A_LADDER, Level, gain_quantities, prnu
from ._illumination import illumination
from ._ladder import Ladder, fit
from ._ledger import Ledger
from ._stack import Accumulator
from ._transfer import MAX_FILL, TransferPoint

SAME_LEVEL = 0.05  # frames of one exposure whose means differ by less belong to one light level
RIGHT_FILL = 0.5
NEAR_HALF = 0.2


@dataclass(frozen=True, kw_only=True)
class Settings:
    """dim: least signal of a flat as a share of the range. saturated: largest share of saturated pixels.
    dead, cold: response below which a pixel carries that flag.
    """

    dim: float = 0.05
    saturated: float = 0.01
    dead: float = 0.2
    cold: float = 0.8


def measure(frames: Iterable[Frame], settings: Settings | None = None, calmap: CalibrationMap | None = None) -> Measurement:
    """Response, illumination, defects and gain.

    Args:
        frames: flats, and darks among them where `calmap` has no dark layers.

    Raises:
        BadInput: no flats, no darks, mixed settings, or all flats saturated or too dim (with the exposure that would be right).
    """
    settings = settings or Settings()
    ledger = Ledger(settings, "flat frames")
    flats, darks, files = _collect(frames, ledger)
    first = ledger.first
    ladder = fit(darks, first.white_level_dn, np.nan) if darks else None
    if not flats:
        raise BadInput("no flat frames among the frames", mend="give frames of an evenly lit field; darks alone are for `dark`")
    names = [files[id(stack)] for _, stack in flats]
    flats.reverse()
    levels = [_level(*flats.pop(), ladder, calmap, first) for _ in names]  # the sums of each stack go as its level comes
    usable = [v for v in levels if _verdict(v, first, settings) is None]
    if not usable:
        raise BadInput("; ".join(dict.fromkeys(_verdict(v, first, settings) for v in levels)),
                       mend="were the folders of darks and flats swapped? else take flats of the exposure named above")
    for level, of_level in zip(levels, names, strict=True):
        if reason := _verdict(level, first, settings):
            ledger.rejected += [(file, reason) for file in of_level]
    best = _best(usable, first)

    smooth = illumination(best.signal_dn, first.bayer_pattern)
    response, uncertainty = _response(best, smooth, first.bayer_pattern)
    dead, cold = response < settings.dead, (response >= settings.dead) & (response < settings.cold)
    row, column = defective_lines(dead | cold)
    dust = find_dust(response, dead | cold)
    points = [_point(v, ladder, calmap) for v in levels if v.freedom and _fill(v, first) < MAX_FILL]
    points = [p for p in points if p is not None]
    gains = gain_quantities(points)
    layers = {"gain_dn_per_e": gains[0].value} if gains[0].value else {}
    if any(v.saturated > 0.5 for v in levels):
        layers["saturation_dn"] = float(first.white_level_dn)
    w, h = first.image_size_px
    counts, edges = np.histogram(response, bins=256, range=(0, 2))
    return Measurement(
        name="flat", image_size_px=(w, h), layers=layers,
        maps={"response": response, "response_uncertainty": uncertainty, "illumination": smooth,
              "defects": with_clusters(flags((h, w), dead=dead, cold=cold, row=row, column=column))},
        quantities=(*gains, *prnu(best, first.bayer_pattern), Quantity(
            name="illumination_fall_off_percent", value=float(100 * (1 - smooth.min())), unit="%",
            source="smooth part of the flat, darkest against brightest; lamp and lens together"), Quantity(
                name="dust_shadows", value=len(dust.depth), unit="1", reason="a count",
                source="compact dips of the response, 5 px and wider, 4 robust sigma and 0.3 % deep"), *NEED_A_LADDER),
        evidence={"transfer_signal_dn": np.array([p.signal_dn for p in points]),
                  "transfer_variance_dn2": np.array([p.variance_dn2 for p in points]),
                  "transfer_variance_uncertainty_dn2": np.array([p.variance_uncertainty_dn2 for p in points]),
                  "level_exposure_s": np.array([np.nan if v.exposure_s is None else v.exposure_s for v in levels]),
                  "level_mean_dn": np.array([v.levels_dn.mean() for v in levels]),
                  "level_saturated": np.array([v.saturated for v in levels]),
                  "dust_xy_px": dust.xy_px, "dust_diameter_px": dust.diameter_px, "dust_depth": dust.depth,
                  "response_histogram_count": counts, "response_histogram_edge": edges},
        provenance=ledger.provenance(), warnings=_warnings(ledger, levels, best, first, settings),
        frames_used=sum(v.count for v in usable) + sum(v.count for v in (ladder.levels if ladder else ())),
        frames_rejected=tuple(ledger.rejected))


def _collect(frames: Iterable[Frame], ledger: Ledger) -> tuple[list[tuple], list[DarkLevel], dict[int, list[str]]]:
    """Flat stacks as (exposure, stack) by exposure and light level, dark levels (of the temperature with most of them), files
    by id of flat stack."""
    files: dict[int, list[str]] = {}
    flats: list[tuple[float | None, Accumulator]] = []
    darks = DarkLevels()
    for frame in frames:
        if frame.kind == "dark":
            check_dark(frame)
        if not ledger.take(frame):
            continue
        if frame.kind == "dark":
            darks.add(frame)
            continue
        mean = float(frame.data.mean())
        stack = next((s for t, s in flats if t == frame.exposure_s and abs(s.level_dn - mean) <= SAME_LEVEL * mean), None)
        if stack is None:
            stack = Accumulator()
            flats.append((frame.exposure_s, stack))
        stack.add(frame)
        files.setdefault(id(stack), []).append(frame.file or frame.name)
    ledger.first  # noqa: B018  raises where there was no frame at all
    return flats, max(darks.groups()[0], key=len, default=[]), files


def _level(exposure_s: float | None, stack: Accumulator, ladder: Ladder | None, calmap: CalibrationMap | None,
           first: Frame) -> Level:
    series = stack.series()
    if ladder is not None:
        dark, variance, origin = ladder.at(exposure_s)
    elif calmap is not None and "offset_dn" in calmap.measured:
        if calmap.image_size_px != first.image_size_px:
            raise BadInput(f"the map is of {calmap.image_size_px} px, the flats of {first.image_size_px} px")
        dark, variance = calmap.offset_dn, calmap.offset_uncertainty_dn**2
        origin = "offset of the map"
        if exposure_s is not None and "dark_rate_dn_per_s" in calmap.measured:
            dark = dark + exposure_s * calmap.dark_rate_dn_per_s
            variance = variance + (exposure_s * calmap.dark_rate_uncertainty_dn_per_s) ** 2
            origin = f"dark layers of the map at {exposure_s:g} s"
    else:
        raise BadInput("flats need darks: none are among the frames, and no map with dark layers was given",
                       mend="add dark frames of the same exposure, or give --map with a measured dark")
    mean = series.stack.mean_dn.astype(np.float32)
    return Level(exposure_s=exposure_s, mean_dn=mean, variance_dn2=series.steady_variance_dn2 if series.freedom else None,
                 freedom=series.freedom, levels_dn=series.levels_dn, dark_dn=dark, dark_variance_dn2=variance,
                 dark_origin=origin, saturated=float(np.mean(mean >= first.white_level_dn * (1 - 1e-3))))


def _fill(level: Level, first: Frame) -> float:
    return typical(level.mean_dn) / first.white_level_dn


def _best(levels: list[Level], first: Frame) -> Level:
    """The level to read the response from: most frames around half of the range, else nearest to half."""
    def preference(level: Level) -> tuple[int, float]:
        off = abs(_fill(level, first) - RIGHT_FILL)
        return (-level.count if off < NEAR_HALF else 0, off)
    return min(levels, key=preference)


def _verdict(level: Level, first: Frame, settings: Settings) -> str | None:
    """Why this level cannot be used, with the exposure that would be right; None: it can."""
    signal, white = typical(level.signal_dn), first.white_level_dn
    if level.saturated > settings.saturated:
        what = f"{100 * level.saturated:.0f} % of the pixels are saturated"
        factor = RIGHT_FILL * (white - float(np.median(level.dark_dn))) / max(signal, 1.0)
    elif signal < settings.dim * white:
        what = f"the flats are too dim: {signal:.1f} DN above dark, of {white:.0f}"
        factor = RIGHT_FILL * (white - float(np.median(level.dark_dn))) / signal if signal > 0 else np.inf
    else:
        return None
    if level.exposure_s is None or not np.isfinite(factor):
        return what
    most = "at most " if level.saturated > settings.saturated else ""
    return f"{what} at {level.exposure_s:g} s; {most}{factor * level.exposure_s:.2g} s would be right"


def _response(level: Level, smooth: np.ndarray, bayer_pattern: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Response (H, W), mean 1 over each Bayer plane, and its 1-sigma uncertainty."""
    response, error = level.signal_dn / smooth, np.zeros(smooth.shape)
    temporal = level.variance_dn2 if level.freedom else np.maximum(level.signal_dn, 0)
    for plane in planes(smooth.shape, bayer_pattern):
        scale = float(np.mean(response[plane]))
        response[plane] /= scale
        # one pixel's variance from few frames is mostly chance: the plane's relation of noise to light is used
        per_light = float(np.median(temporal[plane]) / np.median(level.signal_dn[plane]))
        variance = per_light * np.maximum(level.signal_dn[plane], 0) / level.count + level.dark_variance_dn2[plane]
        error[plane] = np.sqrt(variance) / (smooth[plane] * scale)
    return response, error


def _point(level: Level, ladder: Ladder | None, calmap: CalibrationMap | None) -> TransferPoint | None:
    """Photon transfer point; None where no dark variance is known."""
    variance = float(np.mean(level.variance_dn2))
    relative = np.sqrt(2 / (level.freedom * level.mean_dn.size))
    if ladder is not None and ladder.noise_known:
        nearest = min(range(len(ladder.levels)), key=lambda i: abs((ladder.exposure_s or (0,))[i] - (level.exposure_s or 0)))
        dark = float(np.mean(ladder.variance_dn2[nearest]))
    elif ladder is None and "read_noise_dn" in calmap.measured:
        dark = float(np.mean(calmap.read_noise_dn.astype(float) ** 2))
    else:
        return None
    return TransferPoint(signal_dn=float(np.mean(level.signal_dn)), variance_dn2=variance - dark,
                         variance_uncertainty_dn2=float(relative * np.hypot(variance, dark)))


def _warnings(ledger: Ledger, levels: list[Level], best: Level, first: Frame, settings: Settings) -> tuple[str, ...]:
    out = list(ledger.warnings)
    if first.bit_depth <= 8:
        out.append("8-bit flats: quantisation hides the pixel response")
    out += [f"left out: {why}" for v in levels if (why := _verdict(v, first, settings))]
    if not (best.dark_origin.startswith("darks of") or best.dark_origin.startswith("dark layers")):
        out.append(f"dark below the flats: {best.dark_origin}")
    if best.exposure_s is None:
        out.append("exposure unknown: the dark below the flats may not match them")
    levels_dn = best.levels_dn
    if np.ptp(levels_dn) > 0.01 * levels_dn.mean():
        out.append(f"the light flickers or drifts by {100 * np.ptp(levels_dn) / levels_dn.mean():.1f} % over the flats")
    return tuple(out)
