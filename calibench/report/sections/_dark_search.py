"""How the dark's defects were found: the normal pixels and the threshold, unsteady pixels, temperatures, counts."""

from __future__ import annotations

import math

import numpy as np

from ...calmap.thermal import warming
from ...measure._dark.null import Null
from ...records import Measurement
from ..draw import BLUE, FAINT, GREY, HALF, INK, ORANGE, RED, WIDE, png, sheet
from ..numbers import number, percent, plural, stated, with_uncertainty
from ..section import Figure, Table

BROKEN_AXIS_Z = 60.0


def null_histogram(measurement: Measurement) -> Figure | None:
    """z of all pixels with the distribution of the normal ones and the threshold."""
    evidence = measurement.evidence
    if "z_null" not in evidence:
        return None
    count, edges = evidence["z_histogram_count"], evidence["z_histogram_edge"]
    centre, scale, g, h, threshold = evidence["z_null"]
    made, (axes,) = sheet(HALF)
    shown, largest = edges[:-1] < BROKEN_AXIS_Z, edges[np.flatnonzero(count)[-1] + 1]
    axes.stairs(count[shown] / np.diff(edges)[shown], edges[: shown.sum() + 1], fill=True, color=BLUE, alpha=0.85)
    u = np.linspace(-5, 5.5, 400)
    z = Null(centre=centre, scale=scale, g=g, h=h).quantile(u)
    density = count.sum() * np.exp(-(u**2) / 2) / math.sqrt(2 * math.pi) / np.gradient(z, u)
    axes.plot(z, density, color=INK, linewidth=1, linestyle="--", label="normal pixels (fitted)")
    axes.axvline(threshold, color=RED, linewidth=1, label=f"threshold {number(threshold, 3)}")
    axes.set_yscale("log")
    axes.set(xlabel="z: deviation from the local dark level over its scale", ylabel="pixels for a step of 1 (logarithmic)",
             ylim=(0.5, None), xlim=(max(edges[0], -8), min(BROKEN_AXIS_Z, max(2 * threshold, largest))))
    axes.grid(axis="y", color=FAINT)
    axes.legend(loc="upper right")
    values = {q.name: q for q in measurement.quantities}
    limit = next((values[name] for name in ("hot_detection_limit_e_per_s", "hot_detection_limit_dn_per_s")
                  if name in values and values[name].value is not None), None)
    said = "" if limit is None else (f" An excess of {number(limit.value, 3)} {limit.unit} is found in 99 % of the pixels that "
                                     "have it.")
    above = int(count[edges[:-1] >= threshold].sum())
    return Figure(title="Normal pixels and the threshold", png=png(made),
                  reading=f"About {plural(above, 'pixel')} beyond the threshold of {number(threshold, 3)}; the normal pixels "
                          f"lean to the right by g = {number(g, 2)} (0: Gaussian).{said}")


def telegraph(measurement: Measurement) -> Figure | None:
    """Time series of the telegraph pixels with the largest steps."""
    evidence = measurement.evidence
    series = evidence.get("telegraph_series_dn")
    if series is None or not len(series):
        return None
    places, steps, duty = (evidence[f"telegraph_{name}"] for name in ("xy_px", "step_dn", "duty"))
    shown = min(4, len(series))
    made, all_axes = sheet((WIDE[0], 1.1 * shown + 0.6), 1, shown, sharex=True)
    for axes, values, (x, y), step in zip(all_axes, series[:shown], places, steps, strict=False):
        axes.step(np.arange(1, len(values) + 1), values, where="mid", color=BLUE, linewidth=0.9)
        axes.set_ylabel("DN")
        axes.set_title(f"pixel ({x}, {y}), step {number(step, 3)} DN")
        axes.grid(axis="y", color=FAINT)
    all_axes[-1].set_xlabel("frame")
    return Figure(title="Telegraph pixels, frame by frame", png=png(made), wide=True,
                  reading=f"{plural(len(places), 'pixel')} jump between two levels; steps from {number(steps.min(), 3)} to "
                          f"{number(steps.max(), 3)} DN, in the upper level {percent(float(np.median(duty)))} of the "
                          "time (median).")


def temperature(measurement: Measurement) -> Figure | None:
    """Dark current over temperature with the fitted laws."""
    evidence = measurement.evidence
    if "temperature_c" not in evidence:
        return None
    celsius, rate, error = (evidence[name] for name in ("temperature_c", "temperature_rate_dn_per_s",
                                                        "temperature_rate_uncertainty_dn_per_s"))
    made, (axes,) = sheet(HALF)
    axes.errorbar(celsius, rate, error, fmt="o", color=BLUE, markersize=4.5, capsize=2, label="mean of all pixels")
    axes.plot(celsius, evidence["temperature_hot_rate_dn_per_s"], "^", color=ORANGE, markersize=5,
              label="hottest thousandth, median")
    span = np.linspace(celsius.min(), celsius.max(), 60)
    for name, colour in (("temperature_law", GREY), ("temperature_hot_law", FAINT)):
        if len(evidence.get(name, ())):
            at, energy, reference = evidence[name]
            axes.plot(span, at * warming(span, reference, energy), color=colour, linewidth=1)
    axes.set_yscale("log")
    axes.set(xlabel="temperature (°C)", ylabel="dark rate (DN/s, logarithmic)")
    axes.grid(color=FAINT)
    axes.legend(loc="upper left")
    values = {q.name: q for q in measurement.quantities}
    energy, doubling = values["dark_activation_ev"], values["dark_doubling_c"]
    reading = energy.reason if energy.value is None else (
        f"Activation energy {with_uncertainty(energy.value, energy.uncertainty)} eV: the dark current doubles every "
        f"{with_uncertainty(doubling.value, doubling.uncertainty)} K at the reference temperature.")
    return Figure(title="Dark current against temperature", png=png(made), reading=reading)


def counts(measurement: Measurement) -> Table | None:
    """Hot pixels at each exposure and temperature."""
    evidence = measurement.evidence
    if "count_exposure_s" not in evidence:
        return None
    names = ("count_exposure_s", "count_temperature_c", "count_hot", "count_thesis")
    rows = tuple((stated(t) if np.isfinite(t) else "unknown", number(celsius, 3), str(int(hot)), str(int(thesis)))
                 for t, celsius, hot, thesis in zip(*(evidence[name] for name in names), strict=True))
    columns = ("Exposure (s)", "Temperature (°C)", "Above the limit", "Above mean + 5σ")
    return Table(title="Hot pixels at each exposure and temperature", columns=columns, rows=rows, numbers=frozenset(columns),
                 note="Above the limit: by the averaged frame of this exposure alone, above its median by the charge of the "
                      "limit of `hot` and beyond its robust scatter; mean + 5σ is the thesis rule, all pixels counted in.")
