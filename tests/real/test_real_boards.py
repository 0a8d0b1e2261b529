"""The chessboard views of ../shared/real, through the command line."""

import json

import pytest
from typer.testing import CliRunner

from calibench.cli.app import app


def test_intrinsics_of_the_thirteen_views(real):
    files = sorted(str(f) for f in (real / "boards" / "opencv").glob("*.jpg"))
    result = CliRunner().invoke(app, ["intrinsics", *files, "--board", "9x6", "--square-mm", "25", "--json"])
    assert result.exit_code == 0, result.stderr
    values = json.loads(result.stdout)
    assert values["views_used"] == values["views_given"] == 13
    assert values["rms_px"] <= 0.20
    assert 532.3 < values["fx_px"] < 534.5
    assert values["board_bow_mm"][1] == pytest.approx(-0.17, abs=0.03)
    # the classical error bar is known to be too small on real views
    assert values["uncertainty"]["fx_px"] > 1.5 * values["uncertainty_classical"]["fx_px"]
