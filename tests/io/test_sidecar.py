"""Sidecars: keys, exposure in rows, defaults, and all mistakes at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibench.errors import BadInput, SeveralProblems
from calibench.io.sidecar import exposure_from_rows, sidecar_of


def told(folder: Path, text: str, name: str = "a.png.toml"):
    (folder / name).write_text(text)
    return sidecar_of(folder / "a.png")


def test_no_sidecar_says_nothing(tmp_path: Path):
    sidecar = sidecar_of(tmp_path / "a.png")
    assert sidecar.metadata.exposure_s is None and not sidecar.layout


def test_exposure_in_rows(tmp_path: Path):
    sidecar = told(tmp_path, "exposure_rows = 480\nrow_time_s = 3.175e-5\noverhead_s = 1e-4\n")
    assert sidecar.metadata.exposure_s == pytest.approx(480 * 3.175e-5 + 1e-4, rel=1e-12)
    assert exposure_from_rows(10, 2.0) == 20.0


def test_rows_need_the_row_time(tmp_path: Path):
    with pytest.raises(BadInput, match="row_time_s"):
        told(tmp_path, "exposure_rows = 480\n")


def test_rows_and_seconds_must_agree(tmp_path: Path):
    with pytest.raises(BadInput, match="exposure_rows says"):
        told(tmp_path, "exposure_rows = 480\nrow_time_s = 3e-5\nexposure_s = 0.5\n")


def test_folder_defaults_yield_to_a_frames_own_table(tmp_path: Path):
    text = '[default]\nexposure_s = 1.0\ngain_setting = 3\n[files."a.png"]\nexposure_s = 2.0\n'
    sidecar = told(tmp_path, text, "frames.toml")
    assert (sidecar.metadata.exposure_s, sidecar.metadata.gain_setting) == (2.0, 3)


def test_row_time_may_be_the_folders_and_rows_the_frames(tmp_path: Path):
    (tmp_path / "frames.toml").write_text("[default]\nrow_time_s = 1e-4\nexposure_s = 9.0\n")
    assert told(tmp_path, "exposure_rows = 20\n").metadata.exposure_s == pytest.approx(2e-3)


def test_two_tables_of_one_frame_must_agree(tmp_path: Path):
    (tmp_path / "frames.toml").write_text('[files."a.png"]\nexposure_s = 1.0\n')
    with pytest.raises(BadInput, match="a.png.toml says 2.0, frames.toml says 1.0"):
        told(tmp_path, "exposure_s = 2.0\n")


def test_all_mistakes_at_once_with_their_paths(tmp_path: Path):
    text = ('[default]\nexposure_s = -1\ncolour = "red"\n[files."a.png"]\nbit_depth = 12.5\nkind = "blur"\n'
            'date_obs = "yesterday"\n[extra]\nx = 1\n')
    with pytest.raises(SeveralProblems) as error:
        told(tmp_path, text, "frames.toml")
    wheres = [where for where, _ in error.value.problems]
    assert wheres == ["default.colour", "default.exposure_s", "extra", 'files."a.png".bit_depth',
                      'files."a.png".date_obs', 'files."a.png".kind']


@pytest.mark.parametrize("text", ["exposure_s = ", "exposure_s = nan\n", "exposure_s = true\n", "temperature_c = -300\n",
                                  "width = 0\n", 'packing = "zip"\n', "camera = 5\n", "a" * 1_000_001])
def test_nonsense_is_refused(tmp_path: Path, text):
    with pytest.raises(BadInput, match="a.png.toml"):
        told(tmp_path, text)


def test_focus_and_chief_rays_of_a_point_source_frame(tmp_path):
    (tmp_path / "a.png.toml").write_text("focus_um = -12.5\nchief_rays_px = [[10, 20.5], [30.25, 4]]\n")
    said = sidecar_of(tmp_path / "a.png").metadata
    assert said.focus_um == -12.5 and said.chief_rays_px == ((10, 20.5), (30.25, 4))


@pytest.mark.parametrize("places", ["[1, 2]", "[[1, 2, 3]]", '[["a", 2]]', "[[true, 2]]", "3"])
def test_chief_rays_that_are_no_places_are_refused(tmp_path, places):
    (tmp_path / "a.png.toml").write_text(f"chief_rays_px = {places}\n")
    with pytest.raises(BadInput, match="a list of places"):
        sidecar_of(tmp_path / "a.png")
