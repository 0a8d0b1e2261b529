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
from ._dark.below import DarkBelow, MapDark
from ._dark.darkness import check_dark, high_level
from ._defects import defective_lines, flags, planes
from ._flat.dust import find_dust
from ._flat.figures import NEED_A_LADDER, Level, gain_quantities, lit, prnu
from ._flat.illumination import illumination
from ._flat.levels import RIGHT_FILL, FlatLevel, FlatLevels
from ._frames.glance import glance
from ._frames.ledger import Ledger
from ._quantiles import row_medians
from ._since import with_changes
from ._transfer import MAX_FILL, TransferPoint


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
    flats, darks = _collect(frames, ledger, settings)
    first, levels = ledger.first, flats.levels
    if not levels:
        raise BadInput("no flat frames among the frames", mend="give frames of an evenly lit field; darks alone are for `dark`")
    if darks is not None:
        darks.check(first.white_level_dn, first.bayer_pattern)
        bright = high_level(max(one.level_dn for one in darks.levels), first.white_level_dn)
    else:
        bright = ()
    below = darks or MapDark(calmap, first)
    verdicts = [_verdict(v, below.level_dn(v.exposure_s), first, settings) for v in levels]
    usable = [v for v, verdict in zip(levels, verdicts, strict=True) if verdict is None]
    if not usable:
        raise BadInput("; ".join(dict.fromkeys(verdicts)),
                       mend="were the folders of darks and flats swapped? else take flats of the exposure named above")
    for level, reason in zip(levels, verdicts, strict=True):
        if reason:
            ledger.rejected += [(file, reason) for file in level.files]
    kept = [v for v in usable if v.mean_image_dn is not None]
    if not kept:
        raise BadInput("the brightest flats are mostly dark signal", mend="take flats of shorter exposure in more light")
    best = lit(min(kept, key=flats.preference), below)
    points = [_point(v, below) for v in levels
              if v.freedom and below.noise_known and v.typical_dn < MAX_FILL * first.white_level_dn]
    used = sum(v.count for v in usable) + sum(v.count for v in (darks.levels if darks else ()))
    del below, darks  # three images that nothing asks for any more

    smooth = illumination(best.signal_dn, first.bayer_pattern)
    response, uncertainty = _response(best, smooth, first.bayer_pattern)
    dead, cold = response < settings.dead, (response >= settings.dead) & (response < settings.cold)
    row, column = defective_lines(dead | cold)
    dust = find_dust(response, dead | cold)
    gains = gain_quantities(points)
    layers = {"gain_dn_per_e": gains[0].value} if gains[0].value else {}
    if any(v.saturated > 0.5 for v in levels):
        layers["saturation_dn"] = float(first.white_level_dn)
    w, h = first.image_size_px
    counts, edges = np.histogram(response, bins=256, range=(0, 2))
    measured = Measurement(
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
                  "level_mean_dn": np.array([v.level_dn for v in levels]),
                  "level_saturated": np.array([v.saturated for v in levels]),
                  "dust_xy_px": dust.xy_px, "dust_diameter_px": dust.diameter_px, "dust_depth": dust.depth,
                  "response_histogram_count": counts, "response_histogram_edge": edges},
        provenance=ledger.provenance(), warnings=(*_warnings(ledger, verdicts, best, first, usable), *bright),
        frames_used=used,
        frames_rejected=tuple(ledger.rejected))
    return with_changes(measured, calmap, ("dead", "cold"), "response")


def _collect(frames: Iterable[Frame], ledger: Ledger, settings: Settings) -> tuple[FlatLevels, DarkBelow | None]:
    """One pass: checks, the levels of light, and the darks of the temperature with most of them."""
    flats = FlatLevels(settings.saturated)
    for frame in frames:
        if frame.kind == "dark":
            check_dark(frame)
        if ledger.take(frame):
            flats.add(frame, glance(frame).level_dn)
    ledger.first  # noqa: B018  raises where there was no frame at all
    return flats, flats.close()


def _verdict(level: FlatLevel, dark_dn: float, first: Frame, settings: Settings) -> str | None:
    """Why this level cannot be used, with the exposure that would be right; None: it can."""
    signal, white = level.typical_dn - dark_dn, first.white_level_dn
    if level.saturated > settings.saturated:
        what = f"{100 * level.saturated:.0f} % of the pixels are saturated"
        factor = RIGHT_FILL * (white - dark_dn) / max(signal, 1.0)
    elif signal < settings.dim * white:
        what = f"the flats are too dim: {signal:.1f} DN above dark, of {white:.0f}"
        factor = RIGHT_FILL * (white - dark_dn) / signal if signal > 0 else np.inf
    else:
        return None
    if level.exposure_s is None or not np.isfinite(factor):
        return what
    most = "at most " if level.saturated > settings.saturated else ""
    return f"{what} at {level.exposure_s:g} s; {most}{factor * level.exposure_s:.2g} s would be right"


def _response(level: Level, smooth: np.ndarray, bayer_pattern: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Response (H, W), mean 1 over each Bayer plane, and its 1-sigma uncertainty."""
    response, error = level.signal_dn / smooth, np.zeros_like(smooth)
    temporal = level.variance_dn2 if level.freedom else np.maximum(level.signal_dn, 0)
    for plane in planes(smooth.shape, bayer_pattern):
        scale = float(np.mean(response[plane], dtype=np.float64))
        response[plane] /= scale
        # one pixel's variance from few frames is mostly chance: the plane's relation of noise to light is used
        per_light = float(row_medians(temporal[plane].ravel()) / row_medians(level.signal_dn[plane].ravel()))
        variance = per_light * np.maximum(level.signal_dn[plane], 0) / level.count + level.dark_variance_dn2[plane]
        error[plane] = np.sqrt(variance) / (smooth[plane] * scale)
    return response, error


def _point(level: FlatLevel, below: DarkBelow | MapDark) -> TransferPoint:
    dark = below.noise_dn2(level.exposure_s)
    relative = np.sqrt(2 / (level.freedom * below.pixels))
    return TransferPoint(signal_dn=level.level_dn - below.level_dn(level.exposure_s), variance_dn2=level.variance_dn2 - dark,
                         variance_uncertainty_dn2=float(relative * np.hypot(level.variance_dn2, dark)))


def _warnings(ledger: Ledger, verdicts: list[str | None], best: Level, first: Frame,
              usable: list[FlatLevel]) -> tuple[str, ...]:
    out = list(ledger.warnings)
    if first.bit_depth <= 8:
        out.append("8-bit flats: quantisation hides the pixel response")
    out += [f"left out: {why}" for why in verdicts if why]
    single = [f"{v.level_dn:.0f} DN" for v in usable if not v.freedom]
    if not (best.dark_origin.startswith("darks of") or best.dark_origin.startswith("dark layers")):
        out.append(f"dark below the flats: {best.dark_origin}")
    if not best.freedom:
        out.append("one flat a level: temporal noise unknown, so neither gain nor PRNU; the response holds one frame's noise")
    elif single:
        out.append(f"one flat only at {', '.join(single)}: no temporal noise, so no part in the gain")
    if best.exposure_s is None:
        out.append("exposure unknown: the dark below the flats may not match them")
    levels_dn = best.levels_dn
    if np.ptp(levels_dn) > 0.01 * levels_dn.mean():
        out.append(f"the light flickers or drifts by {100 * np.ptp(levels_dn) / levels_dn.mean():.1f} % over the flats")
    return tuple(out)
