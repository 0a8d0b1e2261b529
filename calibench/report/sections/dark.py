"""Dark: offset, dark rate and the pixels that stand out."""

from __future__ import annotations

import numpy as np

from ...records import DEFECT_FLAGS, Measurement
from ..draw import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    HALF,
    INK,
    ORANGE,
    RED,
    WIDE,
    middle,
    png,
    sensor_axes,
    sensor_image,
    sensor_sheet,
    sheet,
)
from ..layers import layer
from ..numbers import number, percent, plural, stated, with_uncertainty
from ..section import Figure, Section, Table
from ..story import Story
from ..tables import quantity_table
from . import _dark_search as search

ORDER = 30
TITLE = "Dark: offset, dark rate, hot pixels"
MARKS = {"hot": (RED, "o"), "warm": (ORANGE, "."), "stuck": (INK, "s"), "noisy": (GREEN, "^"),
         "telegraph": (GREEN, "v"), "nonlinear": (GREY, "x"), "hot_thesis": (BLUE, "+")}


def render(story: Story) -> Section | None:
    measurement = story.measurements.get("dark")
    if measurement is None:
        return None
    gain = story.calmap.gain_dn_per_e
    figures = (_offset(measurement), _rate(measurement, gain), _rate_histogram(measurement, gain),
               search.null_histogram(measurement),
               _defect_map(measurement), search.temperature(measurement), search.telegraph(measurement), _ladder(measurement))
    tables = (quantity_table("Dark figures", measurement.quantities), _classes(measurement), _exposures(measurement),
              search.counts(measurement))
    return Section(paragraphs=(_summary(measurement),), warnings=measurement.warnings,
                   tables=tuple(t for t in tables if t is not None), figures=tuple(f for f in figures if f is not None))


def _summary(measurement: Measurement) -> str:
    exposures = measurement.evidence.get("exposure_s", np.zeros(0))
    known = exposures[np.isfinite(exposures)]
    ladder = f" at {plural(len(known), 'exposure')} of {_exposure_span(known)}" if len(known) else " of unknown exposure"
    return (f"{plural(measurement.frames_used, 'dark frame')}{ladder}. Maps show the middle 98 % of the pixels; a pointed end "
            "of a colour bar says that some lie beyond.")


def _exposure_span(known: np.ndarray) -> str:
    return f"{stated(known.min())} s" if len(known) == 1 else f"{stated(known.min())} to {stated(known.max())} s"


def _classes(measurement: Measurement) -> Table | None:
    defects = measurement.maps.get("defects")
    if defects is None:
        return None
    counts = {name: int(np.count_nonzero(defects & flag)) for name, flag in DEFECT_FLAGS.items()}
    rows = tuple((name, str(count), percent(count / defects.size)) for name, count in counts.items() if count)
    return Table(title="Defects by class", columns=("Class", "Pixels", "Share"), rows=rows or (("none", "0", percent(0)),),
                 numbers=frozenset({"Pixels", "Share"}), note="A pixel counts in each class that it carries.")


def _exposures(measurement: Measurement) -> Table | None:
    evidence = measurement.evidence
    wanted = ("exposure_s", "frame_count", "mean_level_dn", "temporal_variance_dn2", "hot_thesis_count")
    if not evidence.keys() >= set(wanted):
        return None
    rows = tuple(
        (stated(t) if np.isfinite(t) else "unknown", str(frames), number(level, 5), number(np.sqrt(variance), 3), str(count))
        for t, frames, level, variance, count in zip(*(evidence[name] for name in wanted), strict=True))
    columns = ("Exposure (s)", "Frames", "Mean level (DN)", "Temporal noise (DN)", "Hot by the thesis rule")
    return Table(title="Dark ladder", columns=columns, rows=rows, numbers=frozenset(columns),
                 note="Thesis rule: averaged frame above its mean + 5 standard deviations.")


def _offset(measurement: Measurement) -> Figure | None:
    offset = layer(measurement, "offset_dn")
    if offset is None:
        return None
    made, (axes,) = sensor_sheet(measurement.image_size_px)
    sensor_image(axes, offset, "offset (DN)")
    low, high = middle(offset)
    columns, rows = (np.nanstd(np.nanmedian(offset, axis=axis)) for axis in (0, 1))
    return Figure(title="Offset", png=png(made),
                  reading=f"Median {number(np.nanmedian(offset))} DN, the middle 98 % from {number(low)} to {number(high)} DN; "
                          f"medians of columns scatter by {number(columns, 2)} DN, of rows by {number(rows, 2)} DN (1σ).")


def _in_electrons(rate_dn_per_s: np.ndarray, gain_dn_per_e: float) -> tuple[np.ndarray, str]:
    """Rates in e-/s where the gain is known, else in DN/s, and the unit."""
    known = np.isfinite(gain_dn_per_e)
    return (rate_dn_per_s / gain_dn_per_e, "e-/s") if known else (rate_dn_per_s, "DN/s")


def _rate(measurement: Measurement, gain_dn_per_e: float) -> Figure | None:
    rate = layer(measurement, "dark_rate_dn_per_s")
    if rate is None:
        return None
    rate, unit = _in_electrons(rate, gain_dn_per_e)
    made, (axes,) = sensor_sheet(measurement.image_size_px)
    sensor_image(axes, rate, f"dark rate ({unit})")
    row, column = np.unravel_index(int(np.nanargmax(rate)), rate.shape)
    return Figure(title="Dark rate", png=png(made),
                  reading=f"Median {number(np.nanmedian(rate), 3)} {unit}, mean {number(np.nanmean(rate), 3)} {unit}; the "
                          f"hottest pixel, ({column}, {row}), collects {number(np.nanmax(rate), 3)} {unit}.")


def _rate_histogram(measurement: Measurement, gain_dn_per_e: float) -> Figure | None:
    rate = layer(measurement, "dark_rate_dn_per_s")
    if rate is None:
        return None
    rate, unit = _in_electrons(rate[np.isfinite(rate)], gain_dn_per_e)
    made, (axes,) = sheet(HALF)
    count, edges = np.histogram(rate, bins=160)
    axes.stairs(count, edges, fill=True, color=BLUE, alpha=0.85)
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.7)
    axes.grid(axis="y", color=FAINT)
    middle_rate = np.median(rate)
    axes.axvline(middle_rate, color=GREY, linestyle="--", linewidth=1, label=f"median {number(middle_rate, 3)} {unit}")
    axes.set(xlabel=f"dark rate ({unit})", ylabel="pixels a bin (logarithmic)", xlim=(edges[0], edges[-1]))
    axes.legend(loc="upper right")
    top = np.sort(rate)[-max(1, rate.size // 1000):]
    return Figure(title="Dark rates of all pixels", png=png(made),
                  reading=f"The hottest thousandth of the pixels lies above {number(top[0], 3)} {unit} and holds "
                          f"{percent(top.sum() / rate.sum())} of the dark signal; half of the pixels lie below "
                          f"{number(middle_rate, 3)} {unit}.")


def _defect_map(measurement: Measurement) -> Figure | None:
    defects = measurement.maps.get("defects")
    if defects is None:
        return None
    h, w = defects.shape
    made, (axes,) = sensor_sheet((w, h), bars=False)
    sensor_axes(axes, (w, h))
    said = []
    for name, (colour, marker) in MARKS.items():
        rows, columns = np.nonzero(defects & DEFECT_FLAGS[name])
        if len(rows):
            axes.plot(columns, rows, marker, color=colour, markersize=4, markerfacecolor="none", markeredgewidth=0.7,
                      label=f"{name} ({len(rows)})")
            said.append(f"{len(rows)} {name}")
    bad = (defects & sum(DEFECT_FLAGS[name] for name in MARKS)) != 0
    if said:
        axes.legend(loc="upper left", bbox_to_anchor=(-0.12, -0.16), ncols=len(MARKS), handletextpad=0.1, columnspacing=1.2)
    left, right = np.count_nonzero(bad[:, :w // 2]), np.count_nonzero(bad[:, w // 2:])
    return Figure(title="Where the hot pixels are", png=png(made),
                  reading=f"{', '.join(said) or 'No defect found'}: {percent(bad.mean())} of {defects.size} pixels carry one "
                          f"of these flags, {left} in the left half of the image and {right} in the right.")


def _ladder(measurement: Measurement) -> Figure | None:
    evidence = measurement.evidence
    exposure, level = (evidence.get(name, np.zeros(0)) for name in ("exposure_s", "mean_level_dn"))
    values = {q.name: q for q in measurement.quantities}
    offset, rate = values.get("offset_dn"), values.get("dark_rate_dn_per_s")
    if len(exposure) < 2 or not np.isfinite(exposure).all() or rate is None or rate.value is None:
        return None
    line = offset.value + rate.value * exposure
    made, (above, below) = sheet(WIDE, 2)
    t = np.linspace(0, exposure.max(), 50)
    above.plot(t, offset.value + rate.value * t, color=GREY, linewidth=1, label="fitted line")
    spread = evidence.get("level_sd_dn", np.zeros_like(level))
    points = {"fmt": "o", "color": BLUE, "markersize": 4.5, "capsize": 2}
    above.errorbar(exposure, level, spread, **points, label="mean level, ±1σ of the frames")
    above.set(xlabel="exposure (s)", ylabel="mean dark level (DN)", title="level")
    above.legend(loc="upper left")
    below.axhline(0, color=GREY, linewidth=1)
    below.errorbar(exposure, level - line, spread, **points)
    below.set(xlabel="exposure (s)", ylabel="level minus line (DN)", title="departure from the line")
    for axes in (above, below):
        axes.grid(color=FAINT)
    worst = int(np.argmax(np.abs(level - line)))
    return Figure(title="Dark ladder: mean level against exposure", png=png(made), wide=True,
                  reading=f"The level grows by {with_uncertainty(rate.value, rate.uncertainty)} DN/s from "
                          f"{with_uncertainty(offset.value, offset.uncertainty)} DN; it departs most from the line at "
                          f"{stated(exposure[worst])} s, by {number((level - line)[worst], 2)} DN.")
