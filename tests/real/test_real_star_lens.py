"""Lens from the stars of real frames: residual over all solved frames, and a held-out error that the covariances predict."""

import json

import pytest
from typer.testing import CliRunner

from calibench.cli.app import app


@pytest.mark.parametrize(("folder", "field", "frames", "most_px"), [
    ("esa_tetra3", ["--fov-deg", "11.4"], 8, 0.15), ("creusot_16mm", [], 18, 0.33)])
def test_stars_as_a_target(real, tmp_path, folder, field, frames, most_px):
    out = tmp_path / "lens.fits"
    result = CliRunner().invoke(app, ["star-lens", str(real / "stars" / folder), *field, "--map-out", str(out), "--json"])
    assert result.exit_code == 0, result.stderr
    values = json.loads(result.stdout)
    assert values["views_used"] == values["frames_used"] == frames
    assert values["rms_px"] <= most_px and values["rms_all_px"] <= most_px
    assert 0.8 < values["quantities"]["held_out_over_predicted"]["value"] < 1.25
    assert out.is_file()
