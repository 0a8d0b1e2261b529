"""Flat: the pixels' response, apart from the light of lamp and lens."""

from __future__ import annotations

import numpy as np

from ...records import DEFECT_FLAGS, Measurement
from ..draw import BLUE, DIVERGING, FAINT, GREY, HALF, INK, middle, png, sensor_image, sheet
from ..numbers import number, percent, plural, quantity_row, with_uncertainty
from ..section import Figure, Section, Table
from ..story import Story

ORDER = 40
TITLE = "Flat: response and illumination"


def render(story: Story) -> Section | None:
    measurement = story.measurements.get("flat")
    if measurement is None:
        return None
    figures = (_response(measurement), _illumination(measurement), _histogram(measurement), _transfer(measurement))
    table = Table(title="Flat figures", columns=("Quantity", "Value ± 1σ", "3σ", "Unit", "Definition"),
                  rows=tuple(quantity_row(q) for q in measurement.quantities), numbers=frozenset({"Value ± 1σ", "3σ"}))
    return Section(paragraphs=(f"{plural(measurement.frames_used, 'frame')} used. The response belongs to the sensor and is divided "
                               "out of every frame; the illumination belongs to lamp and lens and is not.",),
                   warnings=measurement.warnings, tables=(table,), figures=tuple(f for f in figures if f is not None))


def _response(measurement: Measurement) -> Figure | None:
    response = measurement.maps.get("response")
    if response is None:
        return None
    made, (axes,) = sheet(HALF)
    reach = float(np.abs(np.array(middle(response)) - 1).max())
    sensor_image(axes, 100 * (response - 1), "response above the mean (%)", cmap=DIVERGING, limits=(-100 * reach, 100 * reach))
    said = f"Pixels scatter by {number(100 * _core_sd(response), 3)} % (robust 1σ)"
    error = measurement.maps.get("response_uncertainty")
    if error is not None:
        said += f", of which {number(100 * float(np.median(error)), 2)} % is the error of the measurement"
    defects = measurement.maps.get("defects")
    if defects is not None:
        dead, cold = (int(np.count_nonzero(defects & DEFECT_FLAGS[name])) for name in ("dead", "cold"))
        said += f"; {plural(dead, 'pixel')} {'is' if dead == 1 else 'are'} dead, {cold} cold"
    return Figure(title="Response of the pixels", png=png(made), reading=said + ".")


def _core_sd(values: np.ndarray) -> float:
    low, high = np.percentile(values, (25, 75))
    return float(high - low) / 1.349


def _illumination(measurement: Measurement) -> Figure | None:
    light = measurement.maps.get("illumination")
    if light is None:
        return None
    made, (axes,) = sheet(HALF)
    relative = 100 * light / np.nanmax(light)
    sensor_image(axes, relative, "light, brightest place = 100 (%)", limits=(float(np.nanmin(relative)), 100.0))
    h, w = light.shape
    lines = axes.contour(np.arange(w), np.arange(h), relative, levels=6, colors="white", linewidths=0.6)
    axes.clabel(lines, fontsize=7, fmt="%.3g")
    row, column = np.unravel_index(int(np.nanargmax(light)), light.shape)
    corners = relative[[0, 0, -1, -1], [0, -1, 0, -1]]
    return Figure(title="Illumination by lamp and lens", png=png(made),
                  reading=f"Brightest at pixel ({column}, {row}); the corners get {number(float(corners.min()), 3)} to "
                          f"{number(float(corners.max()), 3)} % of that.")


def _histogram(measurement: Measurement) -> Figure | None:
    response = measurement.maps.get("response")
    if response is None:
        return None
    sd = max(_core_sd(response), 1e-6)
    count, edges = np.histogram(response, bins=200)
    made, (axes,) = sheet(HALF)
    axes.stairs(count, edges, fill=True, color=BLUE, alpha=0.85)
    centre = (edges[1:] + edges[:-1]) / 2
    normal = response.size * np.diff(edges) * np.exp(-0.5 * ((centre - np.median(response)) / sd) ** 2) / (sd * np.sqrt(2 * np.pi))
    axes.plot(centre, normal, color=INK, linewidth=1, linestyle="--", label=f"normal law of σ = {number(100 * sd, 3)} %")
    axes.set_yscale("log")
    axes.set(xlabel="response (mean = 1)", ylabel="pixels a bin (logarithmic)", ylim=(0.7, None), xlim=(edges[0], edges[-1]))
    axes.grid(axis="y", color=FAINT)
    axes.legend(loc="upper left")
    far = np.abs(response - np.median(response)) > 5 * sd
    return Figure(title="Responses of all pixels", png=png(made),
                  reading=f"{plural(int(far.sum()), 'pixel')} ({percent(float(far.mean()))}) "
                          f"{'lies' if far.sum() == 1 else 'lie'} beyond 5σ of the core; the least responds with "
                          f"{number(float(response.min()), 3)}, the most with {number(float(response.max()), 3)}.")


def _transfer(measurement: Measurement) -> Figure | None:
    """Variance against signal: the gain is the slope."""
    evidence = measurement.evidence
    signal, variance, error = (evidence.get(f"transfer_{name}", np.zeros(0))
                               for name in ("signal_dn", "variance_dn2", "variance_uncertainty_dn2"))
    gain = next((q for q in measurement.quantities if q.name == "gain_dn_per_e"), None)
    if not len(signal) or gain is None or gain.value is None:
        return None
    made, (axes,) = sheet(HALF)
    line = np.linspace(0, 1.08 * signal.max(), 2)
    axes.plot(line, gain.value * line, color=GREY, linewidth=1, label=f"slope {with_uncertainty(gain.value, gain.uncertainty)} DN/e-")
    axes.errorbar(signal, variance, error, fmt="o", color=BLUE, markersize=4.5, capsize=2, label="light levels, ±1σ")
    axes.set(xlabel="signal above dark (DN)", ylabel="temporal variance above dark (DN²)", xlim=(0, None), ylim=(0, None))
    axes.grid(color=FAINT)
    axes.legend(loc="upper left")
    return Figure(title="Photon transfer", png=png(made),
                  reading=f"{plural(len(signal), 'light level')} up to {number(float(signal.max()), 4)} DN give "
                          f"{with_uncertainty(gain.value, gain.uncertainty)} DN/e-, {number(1 / gain.value, 4)} e-/DN.")
