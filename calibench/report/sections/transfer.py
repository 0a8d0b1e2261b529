"""Photon transfer: the sensor's figures as an EMVA 1288 datasheet has them."""

from __future__ import annotations

from ...records import Measurement, Quantity
from ..draw import png
from ..numbers import MISSING, number, plural, with_uncertainty
from ..section import Figure, Section, Table
from ..story import Story
from ..transfer_figures import Shown, figures, planes

ORDER = 45
TITLE = "Photon transfer (EMVA 1288 style, not certified)"
COLUMNS = ("Quantity", "Symbol", "Value ± 1σ", "1σ (%)", "Unit", "Section", "Remark")
NUMBERS = frozenset({"Value ± 1σ", "1σ (%)"})
GREEK = {"sigma": "σ", "alpha": "α", "eta": "η", "rho": "ρ", "mu": "μ"}
LENS = {"yes": "A lens was mounted: the figures are those of the system.", "no": "No lens was mounted."}


def render(story: Story) -> Section | None:
    measurement = story.measurements.get("transfer")
    if measurement is None:
        return None
    shown = planes(measurement)
    return Section(paragraphs=(summary(measurement),), warnings=measurement.warnings,
                   tables=tuple(table(plane) for plane in shown),
                   figures=tuple(Figure(title=_titled(drawn.title, plane), png=png(drawn.made), reading=drawn.reading,
                                        wide=drawn.wide) for plane in shown for drawn in figures(plane)))


def summary(measurement: Measurement) -> str:
    """What was measured, after which standard, and whether a lens was mounted."""
    levels = len(planes(measurement)[0].curves["signal_dn"])
    lens = LENS.get(measurement.provenance.settings.get("lens", ""), "Whether a lens was mounted is not stated.")
    return (f"{plural(measurement.frames_used, 'frame')}, {plural(levels, 'level')} of light, after EMVA 1288 release 4.0 "
            f"Linear. This is no certificate. {lens}")


def table(plane: Shown) -> Table:
    """One row a figure; what is missing says why."""
    rows = tuple(_row(q) for q in plane.values.values())
    return Table(title=_titled("Figures", plane), columns=COLUMNS, rows=rows, numbers=NUMBERS)


def _row(quantity: Quantity) -> tuple[str, ...]:
    value, error = quantity.value, quantity.uncertainty
    relative = number(100 * error / abs(value), 2) if value and error is not None else MISSING
    symbol = quantity.symbol
    for word, letter in GREEK.items():
        symbol = symbol.replace(word, letter)
    return (quantity.name, symbol, with_uncertainty(value, error), relative,
            "" if quantity.unit == "1" else quantity.unit, quantity.source.removeprefix("EMVA 1288 "), quantity.reason)


def _titled(title: str, plane: Shown) -> str:
    return f"{title}, plane {plane.name}" if plane.name else title
