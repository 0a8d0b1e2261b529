"""map diff, map import and map export at the command line."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from calibench.io.map_file import read_map, write_map
from calibench.records import CalibrationMap, Camera, Intrinsics

COMMAND = [sys.executable, "-c", "from calibench.cli import main; main()", "map"]
SIZE = (64, 48)


def run(cwd, *arguments, code: int = 0) -> subprocess.CompletedProcess:
    done = subprocess.run([*COMMAND, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=120)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done


def camera_map(fx_px: float = 500.0) -> CalibrationMap:
    lens = Intrinsics(model="brown4", fx_px=fx_px, fy_px=501.0, cx_px=31.5, cy_px=23.5, image_size_px=SIZE,
                      distortion=[-0.1, 0.02, 1e-7, 0.0], covariance=np.eye(8) * 1e-4)
    return CalibrationMap(image_size_px=SIZE, measured=frozenset(["intrinsics", "offset_dn", "defects"]), intrinsics=lens,
                          offset_dn=np.full((48, 64), fx_px / 10), camera=Camera(name="bench"))


@pytest.fixture
def maps(tmp_path):
    write_map(tmp_path / "a.fits", camera_map())
    write_map(tmp_path / "b.fits", camera_map(510.0))
    return tmp_path


def test_the_difference_is_one_json_object_with_units_in_its_names(maps):
    values = json.loads(run(maps, "diff", "a.fits", "b.fits", "--json").stdout)
    lens = values["intrinsics"]
    assert lens["parameters"]["fx_px"] == {"a": 500, "b": 510, "difference": 10, "uncertainty": pytest.approx(0.02**0.5 / 10)}
    assert 0.1 < lens["rms_px"] < lens["largest_px"] < 0.7 and len(lens["field"]) == lens["points_fitted"]
    assert lens["rms_arcsec"] == pytest.approx(lens["rms_px"] / 500 * 206265, rel=0.05)
    assert values["layers"]["offset_dn"] == {"median": 1, "scatter": 0, "largest": 1}
    assert (values["a"], values["b"], values["defects"], values["only_in_a"]) == ("a.fits", "b.fits", {}, [])


def test_the_difference_for_a_person(maps):
    text = run(maps, "diff", "a.fits", "b.fits", "--fit-radius-px", "20").stdout
    for word in ("px rms (sqrt(mean(dx^2 + dy^2)))", "arcsec", "fx_px", "offset_dn"):
        assert word in text


@pytest.mark.parametrize("format_", ["opencv_yaml", "mrcal_cameramodel"])
def test_an_exported_lens_is_imported_again_without_a_difference(maps, format_):
    run(maps, "export", "a.fits", "--to", format_, "--out", "lens")
    values = json.loads(run(maps, "import", "lens", "--from", format_, "--map-out", "back.fits", "--json").stdout)
    assert values["intrinsics"]["fx_px"] == 500 and values["map_written"] == "back.fits"
    assert json.loads(run(maps, "diff", "a.fits", "back.fits", "--json").stdout)["intrinsics"]["rms_px"] < 1e-9


def test_a_lens_is_added_to_a_copy_of_a_map(maps):
    run(maps, "export", "b.fits", "--to", "opencv_yaml", "--out", "lens.yml")
    done = run(maps, "import", "lens.yml", "--from", "opencv_yaml", "--map", "a.fits", "--map-out", "c.fits")
    assert "imported from lens.yml" in done.stderr
    calmap = read_map(maps / "c.fits")
    assert calmap.intrinsics.fx_px == 510 and calmap.offset_dn[0, 0] == 50 and calmap.camera.name == "bench"
    assert "intrinsics/lens.yml" in calmap.inputs and any("imported" in warning for warning in calmap.warnings)


def test_bad_calls_are_refused_and_write_nothing(maps):
    (maps / "lens.yml").write_text("%YAML:1.0\n---\ncamera_matrix: &a [*a]\n")
    assert "camera_matrix is not a matrix" in run(maps, "import", "lens.yml", "--from", "opencv_yaml", "--map-out", "c.fits",
                                                  code=3).stderr
    assert "choose one of" in run(maps, "import", "lens.yml", "--from", "matlab", "--map-out", "c.fits", code=2).stderr
    write_map(maps / "other.fits", CalibrationMap(image_size_px=(65, 48)))
    assert "64 x 48 and 65 x 48" in run(maps, "diff", "a.fits", "other.fits", code=3).stderr
    assert not (maps / "c.fits").exists()
