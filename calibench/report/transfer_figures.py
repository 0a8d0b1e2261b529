"""The figures of an EMVA 1288 style datasheet: a sheet, its title and a one-line reading each. The report makes images of
them, the datasheet pages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure as Sheet

from ..records import Measurement, Quantity
from .draw import BLUE, FAINT, GREEN, GREY, HALF, INK, ORANGE, RED, WIDE, sheet
from .numbers import number, percent, plural, with_uncertainty

POINTS = {"fmt": "o", "color": BLUE, "markersize": 3.5, "capsize": 2, "linewidth": 1}
LIGHT = {"photons": "photons per pixel", "s": "exposure (s)", "": "level"}
FULL = 0.002  # share of the pixels at the largest value, beyond which a level is saturated
STYLES = (("middle", GREY, 0.8), ("mean", BLUE, 1.4), ("minimum", GREEN, 0.8), ("maximum", RED, 0.8))


class Drawn(NamedTuple):
    """wide: takes the whole width of a page."""

    title: str
    made: Sheet
    reading: str
    wide: bool = False


class Shown(NamedTuple):
    """What one plane has to show: its curves and its figures by name, without the plane's suffix."""

    name: str
    curves: Mapping[str, np.ndarray]
    values: Mapping[str, Quantity]


def planes(measurement: Measurement) -> list[Shown]:
    """The whole sensor, or each colour plane of a mosaic."""
    names = [key.removeprefix("signal_dn").removeprefix("_") for key in measurement.evidence if key.startswith("signal_dn")]
    out = []
    for name in names:
        end = f"_{name}" if name else ""
        out.append(Shown(name, {k.removesuffix(end): v for k, v in measurement.evidence.items() if k.endswith(end)},
                         {q.name.removesuffix(end): q for q in measurement.quantities if q.name.endswith(end)}))
    return out


def figures(shown: Shown) -> Iterator[Drawn]:
    """Every figure for which there is something to show."""
    yield _transfer(shown)
    yield _response(shown)
    yield _snr(shown)
    if len(shown.curves["linearity_deviation_percent"]):
        yield _linearity(shown)
    if np.isfinite(shown.curves["dark_exposure_s"]).all() and len(shown.curves["dark_exposure_s"]) > 1:
        yield _dark_current(shown)
    for which, what in (("dark", "DSNU"), ("bright", "PRNU")):
        if f"{which}_histogram_count" in shown.curves:
            yield _spectrograms(shown, which, what)
            yield _profiles(shown, which, what)
            yield _histograms(shown, which, what)


def _transfer(shown: Shown) -> Drawn:
    c, (slope, offset) = shown.curves, shown.curves["line"]
    signal, variance, error, fitted = (c[n] for n in ("signal_dn", "variance_dn2", "variance_uncertainty_dn2", "fitted"))
    made, (above, below) = sheet(WIDE, 2)
    used, rest = fitted == 1, fitted == 0
    above.errorbar(signal[used], variance[used], error[used], **POINTS, label="up to 70 % of saturation, ±1σ")
    above.plot(signal[rest], variance[rest], "o", color=ORANGE, markersize=3.5, markerfacecolor="none", label="not fitted")
    ends = np.array([0, signal[used].max() * 1.05])
    above.plot(ends, offset + slope * ends, color=INK, linewidth=1, label="line")
    if (full := shown.values["saturation_dn"].value) is not None:
        above.axvline(full, color=GREY, linestyle=":", linewidth=1, label="saturation")
    above.set(xlabel="mean above dark (DN)", ylabel="temporal variance above dark (DN²)", title="photon transfer")
    residual = variance - offset - slope * signal
    below.axhline(0, color=GREY, linewidth=1)
    below.errorbar(signal[used], residual[used], error[used], **POINTS)
    below.set(xlabel="mean above dark (DN)", ylabel="variance minus line (DN²)", title="residuals of the fit")
    _finish(above, below)
    gain = shown.values["gain_dn_per_e"]
    worst = np.abs(residual[used] / np.maximum(error[used], 1e-12)).max()
    return Drawn("Photon transfer", made, f"K = {with_uncertainty(gain.value, gain.uncertainty)} DN/e- from "
                 f"{plural(int(used.sum()), 'level')}; the farthest lies {number(worst, 2)}σ off the line.", True)


def _response(shown: Shown) -> Drawn:
    c = shown.curves
    made, (axes,) = sheet(HALF)
    known = np.isfinite(c["light"]).all()
    light = c["light"] if known else np.arange(len(c["mean_dn"]))
    axes.plot(light, c["mean_dn"], "o", color=BLUE, markersize=3.5)
    r = shown.values["responsivity_dn_per_photon"]
    unit = "photons" if r.value is not None else "s" if known else ""
    if r.value is not None:
        ends = np.array([0, c["light"].max()])
        axes.plot(ends, r.value * ends + (c["mean_dn"] - c["signal_dn"])[0], color=INK, linewidth=1, label="R")
        axes.legend(loc="upper left")
    axes.set(xlabel=LIGHT[unit], ylabel="mean (DN)")
    _finish(axes)
    said = f"R = {with_uncertainty(r.value, r.uncertainty)} DN/photon" if r.value is not None else r.reason
    return Drawn("Characteristic curve", made, f"{said}; {plural(len(light), 'level')} up to {number(c['mean_dn'].max())} DN.")


def _snr(shown: Shown) -> Drawn:
    c = shown.curves
    charge, good = c["charge_e"], (c["charge_e"] > 0) & (c["snr"] > 0) & (c["at_top"] < FULL)
    made, (axes,) = sheet(HALF)
    axes.loglog(charge[good], c["snr"][good], "o", color=BLUE, markersize=3.5, label="measured, temporal noise")
    axes.loglog(charge[good], c["snr_total"][good], color=ORANGE, label="total, with DSNU and PRNU")
    axes.loglog(charge[good], np.sqrt(charge[good]), color=GREY, linewidth=1, linestyle="--", label="ideal sensor")
    axes.set(xlabel="electrons per pixel", ylabel="SNR")
    axes.legend(loc="upper left")
    _finish(axes)
    snr = shown.values["snr_max"]
    said = f"SNR max {with_uncertainty(snr.value, snr.uncertainty)}" if snr.value is not None else snr.reason
    return Drawn("Signal to noise", made, f"{said}; with the fixed pattern at most {number(c['snr_total'][good].max(), 3)}.")


def _linearity(shown: Shown) -> Drawn:
    c = shown.curves
    made, (axes,) = sheet(HALF)
    axes.axhline(0, color=GREY, linewidth=1)
    axes.plot(c["mean_dn"][c["linear"] == 1], c["linearity_deviation_percent"], "o-", color=BLUE, markersize=3.5)
    axes.set(xlabel="mean (DN)", ylabel="deviation from the line (%)")
    _finish(axes)
    error, worst = shown.values["linearity_error_percent"], np.abs(c["linearity_deviation_percent"]).max()
    return Drawn("Linearity", made, f"LE = {with_uncertainty(error.value, error.uncertainty)} % in the mean, "
                                    f"{number(worst, 2)} % at most.")


def _dark_current(shown: Shown) -> Drawn:
    c = shown.curves
    made, (axes,) = sheet(HALF)
    axes.plot(c["dark_exposure_s"], c["dark_mean_dn"], "o", color=BLUE, markersize=3.5)
    offset, rate, current = (shown.values[n] for n in ("offset_dn", "dark_rate_dn_per_s", "dark_current_e_per_s"))
    axes.plot(c["dark_exposure_s"], offset.value + rate.value * c["dark_exposure_s"], color=INK, linewidth=1)
    axes.set(xlabel="exposure (s)", ylabel="mean dark level (DN)")
    _finish(axes)
    return Drawn("Dark current", made, f"{with_uncertainty(current.value, current.uncertainty)} e-/s over "
                                       f"{plural(len(c['dark_exposure_s']), 'exposure')}.")


def _spectrograms(shown: Shown, which: str, what: str) -> Drawn:
    made, panels = sheet(WIDE, 2)
    temporal = float(shown.curves[f"{which}_temporal_dn"][0])
    fixed = _pattern_dn(shown, what)
    said = []
    for axes, way in zip(panels, ("rows", "columns"), strict=True):
        power = shown.curves[f"{which}_spectrum_{way}_dn"]
        cycles = np.linspace(0, 0.5, len(power))
        axes.plot(cycles[1:], power[1:].clip(1e-6), color=BLUE, linewidth=0.8)
        axes.axhline(temporal, color=GREY, linestyle="--", linewidth=1, label="temporal noise left in the mean")
        if fixed:
            axes.axhline(fixed, color=ORANGE, linestyle="--", linewidth=1, label=f"{what}1288")
        wide = max(power[1:].max(), temporal) > 10 * max(min(power[1:].min(), temporal, fixed or np.inf), 1e-6)
        axes.set(xlabel="cycles per pixel", ylabel="root of the mean power (DN)", title=f"along the {way}",
                 yscale="log" if wide else "linear")
        _above(axes)
        strongest = 1 + int(np.argmax(power[1:]))
        said.append(f"along the {way} the strongest wave has {number(cycles[strongest], 3)} cycles per pixel")
    _finish(*panels)
    return Drawn(f"Spectrograms, {what}", made, f"High-passed; {'; '.join(said)}.", True)


def _pattern_dn(shown: Shown, what: str) -> float:
    """DSNU1288 or PRNU1288 in DN, where white noise of that size would lie; 0 where there is none."""
    value, gain = (shown.values[n].value for n in ("dsnu_1288_e" if what == "DSNU" else "prnu_1288_percent", "gain_dn_per_e"))
    if not value:
        return 0.0
    if what == "DSNU":
        return value * gain
    dark_dn, bright_dn = (float(shown.curves[f"{kind}_profile_rows_dn"][1].mean()) for kind in ("dark", "bright"))
    return value / 100 * (bright_dn - dark_dn)


def _profiles(shown: Shown, which: str, what: str) -> Drawn:
    made, panels = sheet(WIDE, 2)
    for axes, way, across in zip(panels, ("rows", "columns"), ("column x (px)", "row y (px)"), strict=True):
        for (label, colour, width), values in zip(STYLES, shown.curves[f"{which}_profile_{way}_dn"], strict=True):
            axes.plot(values, color=colour, linewidth=width, label=label)
        axes.set(xlabel=across, ylabel="DN", title=f"over all {way}")
        _above(axes)
    _finish(*panels)
    mean = shown.curves[f"{which}_profile_rows_dn"][1]
    return Drawn(f"Profiles, {what}", made, f"Not high-passed; the mean row runs from {number(mean.min())} to "
                                            f"{number(mean.max())} DN.", True)


def _histograms(shown: Shown, which: str, what: str) -> Drawn:
    made, (log, accumulated) = sheet(WIDE, 2)
    count, edges = shown.curves[f"{which}_histogram_count"], shown.curves[f"{which}_histogram_edge_dn"]
    log.stairs(count, edges, color=BLUE, fill=True, alpha=0.85)
    centre, total = (edges[1:] + edges[:-1]) / 2, count.sum()
    share = count.cumsum() / total
    sd = (np.interp(0.84134, share, edges[1:]) - np.interp(0.15866, share, edges[1:])) / 2
    log.plot(centre, total * np.diff(edges) * np.exp(-0.5 * (centre / sd) ** 2) / (sd * np.sqrt(2 * np.pi)), color=INK,
             linestyle="--", linewidth=1, label=f"normal law of σ = {number(sd, 3)} DN")
    log.set(yscale="log", ylim=(0.7, 2 * count.max()), xlabel="deviation (DN)", ylabel="pixels", title="logarithmic")
    log.legend(loc="upper left")
    deviation, percents = shown.curves[f"{which}_accumulated_dn"], shown.curves[f"{which}_accumulated_percent"]
    accumulated.semilogy(deviation, percents.clip(100 / total / 2), color=BLUE)
    accumulated.set(xlabel="absolute deviation (DN)", ylabel="% of the pixels at least so far off", title="accumulated")
    _finish(log, accumulated)
    far = np.interp(5 * sd, deviation, percents) / 100
    return Drawn(f"Histograms, {what}", made, f"High-passed; beyond 5σ of the core lie {percent(far)} of the pixels.", True)


def _above(axes: object) -> None:
    """The legend over the axes, where no curve runs."""
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, borderaxespad=0.1, handlelength=1.5, columnspacing=1.2)


def _finish(*panels: object) -> None:
    for axes in panels:
        axes.grid(color=FAINT)
    panels[0].legend(loc="upper left") if panels[0].get_legend_handles_labels()[0] and not panels[0].get_legend() else None
