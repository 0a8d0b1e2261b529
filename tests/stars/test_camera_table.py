"""A table for one camera: merged doubles, the limit, the stars in view, and the file that holds it."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from calibench.cli.app import app
from calibench.errors import BadInput
from calibench.geometry import sphere
from calibench.io.star_table import load_star_table, write_star_table
from calibench.records import StarTable
from calibench.stars.camera_table import camera_table

ARCSEC = np.pi / 180 / 3600


def table(ra_arcsec, hp, pm=None):
    n = len(hp)
    zero = np.zeros(n)
    return StarTable(epoch_jyear=2000.0, hip=np.arange(1, n + 1), hr=np.zeros(n, int), ra_rad=np.array(ra_arcsec) * ARCSEC,
                     dec_rad=zero, pm_ra_mas_yr=zero if pm is None else np.array(pm, float), pm_dec_mas_yr=zero,
                     parallax_mas=zero, hp_mag=np.array(hp, float), v_mag=np.array(hp, float), b_v=zero,
                     spectral_type=np.full(n, ""))


def test_a_pair_becomes_one_spot_at_its_light():
    made = camera_table(table([0, 100, 5000], [4.0, 4.0, 5.0], [10, 30, 7]), faintest_hp=5.0, part_rad=150 * ARCSEC)
    assert made.table.hip.tolist() == [1, 3]
    assert made.table.ra_rad[0] / ARCSEC == pytest.approx(50, abs=1e-6)
    assert made.table.hp_mag[0] == pytest.approx(4 - 2.5 * np.log10(2))
    assert made.table.pm_ra_mas_yr[0] == pytest.approx(20)
    (one,) = made.merged
    assert one.hip == (1, 2) and one.shift_rad / ARCSEC == pytest.approx(50, abs=1e-6)


def test_a_chain_is_not_swallowed_whole_and_unequal_light_counts():
    made = camera_table(table([0, 100, 200], [3.0, 5.5, 5.0]), faintest_hp=5.0, part_rad=150 * ARCSEC)
    assert made.table.hip.tolist() == [1, 3]  # 2 belongs to 1; 3 is too far from 1
    assert made.table.ra_rad[0] / ARCSEC == pytest.approx(100 * 0.1 / 1.1, abs=1e-6)
    assert made.table.ra_rad[1] / ARCSEC == pytest.approx(200)


def test_the_shipped_sky(tmp_path):
    made = camera_table(load_star_table(), faintest_hp=6.0, part_rad=0.0, field_rad=np.radians(29.7))
    assert made.merged == () and made.poor_views == 0.0
    stars = (load_star_table().hp_mag <= 6).sum()
    expected = stars * (1 - np.cos(np.radians(29.7 / 2))) / 2
    assert made.stars_in_view.mean() == pytest.approx(expected, rel=0.01)
    narrow = camera_table(load_star_table(), faintest_hp=4.0, part_rad=0.0, field_rad=np.radians(8))
    assert narrow.poor_views > 0.5


@pytest.mark.parametrize(("limit", "complaint"), [(9.0, "ends at Hp 7.0"), (-5.0, "no star")])
def test_impossible_limits(limit, complaint):
    with pytest.raises(BadInput, match=complaint):
        camera_table(load_star_table(), faintest_hp=limit, part_rad=0.0)


def test_the_command_writes_what_solve_takes_and_a_changed_file_is_refused(tmp_path):
    out = tmp_path / "c.npz"
    words = ["catalogue", "build", "--out", str(out), "--limit-mag", "5.5", "--fov-deg", "29.7", "--width-px", "752", "--json"]
    said = json.loads(CliRunner().invoke(app, words).stdout)
    made = load_star_table(out)
    assert len(made) == said["stars"] and said["merged"] and "merged within 2 px" in made.source
    v = sphere.unit_from_radec(made.ra_rad, made.dec_rad)
    nearest = np.sort(v @ v.T, axis=1)[:, -2]
    # nothing is left within two pixels of a brighter star's own place, save where a merged spot moved towards a neighbour
    assert (np.arccos(np.clip(nearest, -1, 1)) < 2 * 145 * ARCSEC).sum() < 10
    columns = dict(np.load(out))
    columns["ra_rad"] = columns["ra_rad"] + 1e-6
    np.savez(out, **columns)
    with pytest.raises(BadInput, match="SHA-256"):
        load_star_table(out)
    out.write_bytes(out.read_bytes()[:5000])
    with pytest.raises(BadInput, match="star table"):
        load_star_table(out)
    assert CliRunner().invoke(app, words[:4]).exit_code != 0  # neither map nor field


def test_a_table_survives_the_disk(tmp_path):
    write_star_table(tmp_path / "t.npz", table([0, 100], [4.0, 5.0]))
    back = load_star_table(tmp_path / "t.npz")
    assert back.hip.tolist() == [1, 2] and back.epoch_jyear == 2000.0
