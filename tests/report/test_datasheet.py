"""The datasheet in its four forms, from a map."""

from __future__ import annotations

import csv
import io
import json

import pytest

from calibench.errors import BadInput
from calibench.measure import transfer
from calibench.records import CalibrationMap
from calibench.report.datasheet import LABEL, datasheet, measurement_of
from calibench.report.sections.transfer import table
from calibench.report.transfer_figures import planes
from calibench.session.measuring import into_map


@pytest.fixture(scope="module")
def calmap(light_ladder):
    return into_map([transfer.measure(light_ladder(1, levels=16, stack=8), transfer.Settings(lens="no"))], None)


def test_every_form_holds_the_figures_and_says_that_it_is_no_certificate(calmap):
    page = datasheet(calmap, ".html").decode()
    assert LABEL in page and "No lens was mounted" in page and "quantum_efficiency_percent" in page
    assert page.count("data:image/png") == 11
    values = json.loads(datasheet(calmap, ".json"))
    assert values["label"] == LABEL and values["lens"] == "no"
    gain = calmap.quantities["transfer.gain_dn_per_e"]
    assert values["quantities"]["gain_dn_per_e"]["value"] == gain.value
    rows = {row["name"]: row for row in csv.DictReader(io.StringIO(datasheet(calmap, ".csv").decode()))}
    assert float(rows["gain_dn_per_e"]["uncertainty"]) == gain.uncertainty
    assert len(rows) == len(values["quantities"]) == sum(k.startswith("transfer.") for k in calmap.quantities)


def test_pdf_has_the_table_and_a_page_a_figure(calmap):
    made = datasheet(calmap, ".pdf")
    assert made.startswith(b"%PDF") and made.count(b"/Type /Page\n") + made.count(b"/Type /Page ") >= 12


def test_a_mosaic_has_a_table_a_plane(light_ladder):
    mosaic = into_map([transfer.measure(light_ladder(2, levels=16, stack=0, bayer="RGGB"))], None)
    shown = planes(measurement_of(mosaic))
    assert [table(plane).title for plane in shown] == [f"Figures, plane {name}" for name in ("r", "gr", "gb", "b")]
    assert len({len(plane.values) for plane in shown}) == 1 and len(shown[0].values) > 40


def test_a_map_without_photon_transfer_is_refused():
    with pytest.raises(BadInput, match="no photon transfer"):
        datasheet(CalibrationMap(image_size_px=(8, 6)), ".json")
