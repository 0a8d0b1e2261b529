"""Flat: the pixels' response, apart from the light of lamp and lens."""

from __future__ import annotations

import numpy as np
from matplotlib.patches import Circle

from ...records import DEFECT_FLAGS, Measurement
from ..draw import BLUE, DIVERGING, FAINT, GREY, HALF, INK, middle, png, sensor_image, sensor_sheet, sheet
from ..layers import layer
from ..numbers import number, percent, plural, sentence, with_uncertainty
from ..section import Figure, Section, Table
from ..story import Story
from ..tables import quantity_table

ORDER = 40
TITLE = "Flat: response and illumination"
MOST_DUST = 12


def render(story: Story) -> Section | None:
    measurement = story.measurements.get("flat")
    if measurement is None:
        return None
    figures = (_response(measurement), _illumination(measurement), _histogram(measurement), _transfer(measurement))
    summary = (f"{plural(measurement.frames_used, 'frame')} used. The response belongs to the sensor and is divided out of "
               "every frame; the illumination belongs to lamp and lens and is not.")
    tables = (quantity_table("Flat figures", measurement.quantities), _dust(measurement))
    return Section(paragraphs=(summary,), warnings=measurement.warnings, tables=tuple(t for t in tables if t is not None),
                   figures=tuple(f for f in figures if f is not None))


def _response(measurement: Measurement) -> Figure | None:
    response = layer(measurement, "response")
    if response is None:
        return None
    made, (axes,) = sensor_sheet(measurement.image_size_px)
    percent_above = 100 * (response - 1)
    reach = np.abs(middle(percent_above)).max()
    sensor_image(axes, percent_above, "response above the mean (%)", cmap=DIVERGING, limits=(-reach, reach))
    dust, wide = (measurement.evidence.get(f"dust_{name}", np.zeros((0, 2))) for name in ("xy_px", "diameter_px"))
    for (x, y), diameter in zip(dust, wide, strict=True):
        axes.add_patch(Circle((x, y), diameter, fill=False, edgecolor=INK, linewidth=0.8))
    said = [f"pixels scatter by {percent(_core_sd(response))} (robust 1σ)"]
    error = layer(measurement, "response_uncertainty")
    if error is not None:
        said.append(f"the measurement's own error is {percent(np.nanmedian(error))} a pixel (median)")
    defects = measurement.maps.get("defects")
    if defects is not None:
        said += [f"{plural(len(dust), 'shadow')} of dust, circled"] if len(dust) else []
        said += [f"{name}: {plural(np.count_nonzero(defects & DEFECT_FLAGS[name]), 'pixel')}" for name in ("dead", "cold")]
    return Figure(title="Response of the pixels", png=png(made), reading=sentence(*said))


def _dust(measurement: Measurement) -> Table | None:
    """The deepest shadows of dust, with place, width and depth."""
    evidence = measurement.evidence
    if not len(evidence.get("dust_depth", ())):
        return None
    found = list(zip(evidence["dust_xy_px"], evidence["dust_diameter_px"], evidence["dust_depth"], strict=True))
    columns = ("Column x (px)", "Row y (px)", "Diameter (px)", "Depth (%)")
    rows = tuple((f"{x:.0f}", f"{y:.0f}", f"{diameter:.0f}", number(100 * depth, 2))
                 for (x, y), diameter, depth in found[:MOST_DUST])
    more = f" The {MOST_DUST} deepest of {len(found)}." if len(found) > MOST_DUST else ""
    return Table(title="Shadows of dust", columns=columns, rows=rows, numbers=frozenset(columns),
                 note=f"Part of the response: divided out as long as the dust stays where it is.{more}")


def _core_sd(values: np.ndarray) -> float:
    low, high = np.nanpercentile(values, (25, 75))
    return float(high - low) / 1.349


def _illumination(measurement: Measurement) -> Figure | None:
    light = layer(measurement, "illumination")
    if light is None:
        return None
    made, (axes,) = sensor_sheet(measurement.image_size_px)
    relative = 100 * light / np.nanmax(light)
    sensor_image(axes, relative, "light, brightest place = 100 (%)", limits=(np.nanmin(relative), 100.0))
    h, w = light.shape
    lines = axes.contour(np.arange(w), np.arange(h), relative, levels=6, colors="white", linewidths=0.6)
    axes.clabel(lines, fontsize=7, fmt="%.3g")
    row, column = np.unravel_index(int(np.nanargmax(light)), light.shape)
    corners = relative[[0, 0, -1, -1], [0, -1, 0, -1]]
    return Figure(title="Illumination by lamp and lens", png=png(made),
                  reading=f"Brightest at pixel ({column}, {row}); the corners get {number(np.nanmin(corners), 3)} to "
                          f"{number(np.nanmax(corners), 3)} % of that.")


def _histogram(measurement: Measurement) -> Figure | None:
    response = layer(measurement, "response")
    if response is None:
        return None
    response = response[np.isfinite(response)]
    sd = max(_core_sd(response), 1e-6)
    count, edges = np.histogram(response, bins=200)
    made, (axes,) = sheet(HALF)
    axes.stairs(count, edges, fill=True, color=BLUE, alpha=0.85)
    centre, typical = (edges[1:] + edges[:-1]) / 2, np.median(response)
    normal = np.exp(-0.5 * ((centre - typical) / sd) ** 2) / (sd * np.sqrt(2 * np.pi)) * response.size * np.diff(edges)
    axes.plot(centre, normal, color=INK, linewidth=1, linestyle="--", label=f"normal law of σ = {number(100 * sd, 3)} %")
    axes.set_yscale("log")
    axes.set(xlabel="response (mean = 1)", ylabel="pixels a bin (logarithmic)", ylim=(0.7, 2 * count.max()),
             xlim=(edges[0], edges[-1]))
    axes.grid(axis="y", color=FAINT)
    axes.legend(loc="upper left")
    far = np.abs(response - typical) > 5 * sd
    return Figure(title="Responses of all pixels", png=png(made),
                  reading=f"Beyond 5σ of the core: {plural(np.count_nonzero(far), 'pixel')} ({percent(far.mean())}); the "
                          f"weakest responds with {number(response.min(), 3)}, the strongest with {number(response.max(), 3)}.")


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
    slope = with_uncertainty(gain.value, gain.uncertainty)
    axes.plot(line, gain.value * line, color=GREY, linewidth=1, label=f"slope {slope} DN/e-")
    axes.errorbar(signal, variance, error, fmt="o", color=BLUE, markersize=4.5, capsize=2, label="light levels, ±1σ")
    axes.set(xlabel="signal above dark (DN)", ylabel="temporal variance above dark (DN²)", xlim=(0, None), ylim=(0, None))
    axes.grid(color=FAINT)
    axes.legend(loc="upper left")
    return Figure(title="Photon transfer", png=png(made),
                  reading=f"{plural(len(signal), 'light level')} up to {number(signal.max())} DN: gain {slope} DN/e-, "
                          f"{number(1 / gain.value)} e-/DN.")
