"""The datasheet of a photon transfer measurement that a map holds: HTML, PDF, JSON or CSV; EMVA 1288 style, not certified."""

from __future__ import annotations

import csv
import io
import json
import textwrap

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure as Sheet

from ..errors import BadInput
from ..records import CalibrationMap, Measurement, Provenance
from .build import build_report
from .draw import GREY, sheet, style
from .numbers import MISSING
from .section import Table
from .sections.transfer import summary, table
from .story import Story
from .transfer_figures import figures, planes

LABEL = "EMVA 1288 style, not certified"
PAGE_IN = (8.27, 11.69)  # A4
ROWS_A_PAGE, LONGEST_CELL, LINE = 52, 70, 130
FIELDS = ("name", "symbol", "value", "uncertainty", "unit", "source", "reason")


def datasheet(calmap: CalibrationMap, suffix: str) -> bytes:
    """The file's bytes. suffix: .html, .pdf, .json or .csv.

    Raises:
        BadInput: the map holds no photon transfer measurement.
    """
    return {".html": _html, ".pdf": _pdf, ".json": _json, ".csv": _csv}[suffix](calmap, measurement_of(calmap))


def measurement_of(calmap: CalibrationMap) -> Measurement:
    """The photon transfer measurement that was put into the map.

    Raises:
        BadInput: there is none.
    """
    quantities = tuple(q for key, q in calmap.quantities.items() if key.startswith("transfer."))
    evidence = {key.partition("/")[2]: a for key, a in calmap.evidence.items() if key.startswith("transfer/")}
    if not quantities or not evidence:
        raise BadInput("the map holds no photon transfer measurement", mend="make one: calibench transfer FRAMES --map-out MAP")
    inputs = {key.partition("/")[2]: sha for key, sha in calmap.inputs.items() if key.startswith("transfer/")}
    warnings = tuple(w.partition(": ")[2] for w in calmap.warnings if w.startswith("transfer: "))
    return Measurement(name="transfer", image_size_px=calmap.image_size_px, quantities=quantities, evidence=evidence,
                       provenance=Provenance(inputs=inputs, settings=calmap.settings.get("transfer", {})), warnings=warnings,
                       frames_used=len(inputs))


def _html(calmap: CalibrationMap, measurement: Measurement) -> bytes:
    return build_report(Story(title=f"Datasheet {calmap.camera.name or 'of a camera'}", why=LABEL, created=calmap.created,
                              software=calmap.software, calmap=calmap, measurements={"transfer": measurement})).encode()


def _pdf(calmap: CalibrationMap, measurement: Measurement) -> bytes:
    out = io.BytesIO()
    head = f"{calmap.camera.name or 'camera'}, {calmap.image_size_px[0]} × {calmap.image_size_px[1]} px. {LABEL}"
    with style(), PdfPages(out, metadata={"Title": head, "Creator": calmap.software, "CreationDate": None}) as pages:
        for plane in planes(measurement):
            figures_table = table(plane)
            for first in range(0, len(figures_table.rows), ROWS_A_PAGE):
                pages.savefig(_table_page(figures_table, first, head, summary(measurement), measurement.warnings))
            for drawn in figures(plane):
                title = f"{drawn.title}, plane {plane.name}" if plane.name else drawn.title
                drawn.made.suptitle(f"{title}. {drawn.reading}", fontsize=8, x=0.01, ha="left")
                pages.savefig(drawn.made)
    return out.getvalue()


def _table_page(made: Table, first: int, head: str, said: str, warnings: tuple[str, ...]) -> Sheet:
    page, (axes,) = sheet(PAGE_IN)
    axes.set_axis_off()
    lines = [head, said, *(f"Warning: {text}" for text in warnings)]
    axes.set_title("\n".join(part for text in lines for part in textwrap.wrap(text, LINE)), fontsize=7, color=GREY)
    heads = ("Quantity", "Symbol", "Value ± 1σ", "Unit", "Section")
    rows = []
    for cells in made.rows[first:first + ROWS_A_PAGE]:
        row = dict(zip(made.columns, cells, strict=True))
        last = row["Remark"] if row["Value ± 1σ"] == MISSING else row["Section"]
        rows.append([*(row[head] for head in heads[:-1]), textwrap.shorten(last, LONGEST_CELL, placeholder=" …")])
    drawn = axes.table(cellText=rows, colLabels=heads, loc="upper left", cellLoc="left", edges="B")
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(5.5)
    drawn.auto_set_column_width(range(len(heads)))
    return page


def _json(calmap: CalibrationMap, measurement: Measurement) -> bytes:
    values = {"label": LABEL, "camera": calmap.camera.name, "image_size_px": list(calmap.image_size_px),
              "created": calmap.created, "software": calmap.software, "lens": measurement.provenance.settings.get("lens", ""),
              "quantities": {q.name: q.as_json() for q in measurement.quantities}, "warnings": list(measurement.warnings)}
    return json.dumps(values, indent=1, allow_nan=False).encode()


def _csv(calmap: CalibrationMap, measurement: Measurement) -> bytes:
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(FIELDS)
    for q in measurement.quantities:
        writer.writerow(["" if (value := getattr(q, name)) is None else value for name in FIELDS])
    return out.getvalue().encode()
