"""The main job, as a person starts it: the sample session from frames to attitude, map and report."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

from calibench.geometry import rotation, sphere
from calibench.io.map_file import read_map, verify_map
from calibench.session.render import load_truth

COMMAND = [sys.executable, "-c", "from calibench.cli import main; main()"]


def calibench(*arguments, cwd):
    return subprocess.run([*COMMAND, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=600)


@pytest.fixture(scope="module")
def demo(tmp_path_factory, root):
    out = tmp_path_factory.mktemp("demo")
    done = calibench("demo", "--out", out, "--json", cwd=root)
    assert done.returncode == 0, done.stderr
    return out, json.loads(done.stdout), load_truth(root / "sample_frames" / "truth.toml")


def test_everything_is_written_and_within_limits(demo):
    out, results, _ = demo
    assert results["within_limits"] and {v["status"] for v in results["verdicts"]} == {"pass"}
    assert all(check.ok for check in verify_map(out / "calibration.fits"))
    assert (out / "report.html").stat().st_size > 500_000
    assert results["report"].endswith("report.html")


def test_the_lens_is_found_within_its_error_bar(demo):
    _, results, truth = demo
    lens = results["measurements"]["intrinsics"]
    for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
        off = (lens[name] - truth["intrinsics"][name]) / lens["uncertainty"][name]
        assert abs(off) < 4, (name, off)


def test_gain_and_read_noise_are_the_cameras(demo):
    _, results, truth = demo
    sensor = truth["sensor"]
    gain = results["measurements"]["flat"]["quantities"]["gain_dn_per_e"]
    assert gain["value"] == pytest.approx(sensor["gain_dn_per_e"], abs=4 * gain["uncertainty"])
    noise = results["measurements"]["dark"]["quantities"]["read_noise_e"]
    assert noise["value"] == pytest.approx(sensor["temporal_dark_noise_e"], rel=0.02)


def test_hot_pixels_are_the_true_ones(demo):
    out, _, truth = demo
    flags = read_map(out / "calibration.fits").defects
    hot = [(x, y) for x, y, rate in truth["defects"]["hot"] if rate > 60]
    assert np.mean([flags[y, x] & 2 != 0 for x, y in hot]) > 0.98


def test_every_sky_frame_is_solved_and_the_map_earns_its_place(demo):
    _, results, truth = demo
    offsets = []
    for frame in results["frames"]:
        name = frame["file"].rsplit("/", 1)[-1]
        true = truth["frames"][f"sky/{name}"]
        here, there = (sphere.unit_from_radec(np.radians(f["ra_deg"]), np.radians(f["dec_deg"])) for f in (frame, true))
        cross = np.degrees(sphere.angle_between(here, there)) * 3600
        assert cross < 4 * 2**0.5 * np.hypot(frame["sigma_cross_arcsec"], frame["sigma_systematic_cross_arcsec"])
        assert cross < 6
        roll = ((frame["roll_deg"] - true["roll_deg"] + 180) % 360 - 180) * 3600
        assert abs(roll) < 4 * np.hypot(frame["sigma_roll_arcsec"], frame["sigma_systematic_roll_arcsec"])
        # The quaternion is about the optical axis, so an error of the principal point is in it: far larger, and common to all
        matrices = [rotation.matrix_from_quaternion(np.array(f["q_cam_icrs"])) for f in (frame, true)]
        offsets.append(rotation.rotvec_from_matrix(matrices[0] @ matrices[1].T) * 180 * 3600 / np.pi)
        assert frame["false_match_probability"] < 1e-20 and frame["matches"] > 50
    assert np.std(offsets, axis=0)[:2].max() < 5
    rows = {row["map"]: row for row in results["ablation"]["rows"]}
    assert rows["no map"]["error_arcsec"] > 3 * rows["whole map"]["error_arcsec"]
    assert rows["without intrinsics"]["earned_arcsec"] > 5


def test_the_map_serves_single_commands(demo, root, tmp_path):
    out, _, _ = demo
    frame = root / "sample_frames" / "sky" / "sky_01_orion.png"
    done = calibench("solve", frame, "--map", out / "calibration.fits", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    solved = json.loads(done.stdout)["frames"][0]
    assert solved["lens_from"] == "map" and not solved["map_outside_conditions"]
    assert {star["hip"] for star in solved["stars"]} >= {26311, 26727, 25930}  # Orion's belt
    done = calibench("map", "apply", out / "calibration.fits", frame, "--out", tmp_path / "corrected", cwd=tmp_path)
    assert done.returncode == 0 and (tmp_path / "corrected" / "sky_01_orion.corrected.fits").is_file()


def test_a_session_grows_shot_by_shot(root, tmp_path):
    session = tmp_path / "bench"
    assert calibench("new", session, cwd=tmp_path).returncode == 0
    plan = json.loads(calibench("plan", session, "--json", cwd=tmp_path).stdout)
    assert [s["frames_found"] for s in plan["shots"]] == [0] * 5
    done = calibench("run", session, cwd=tmp_path)
    assert done.returncode == 3 and "boards: 0 of 12 frames" in done.stderr
    shutil.copytree(root / "sample_frames" / "boards", session / "boards", dirs_exist_ok=True)
    checked = calibench("check", session, "--json", cwd=tmp_path)
    assert checked.returncode == 1
    status = {s["name"]: s["status"] for s in json.loads(checked.stdout)["shots"]}
    assert status == {"boards": "pass", "darks": "fail", "flats": "fail", "spots": "fail", "sky": "skipped"}


def test_a_shot_of_stars_measures_the_lens(root, tmp_path):
    session = tmp_path / "stars"
    session.mkdir()
    shutil.copytree(root / "sample_frames" / "sky", session / "sky")
    (session / "session.toml").write_text(
        '[protocol]\nschema = 1\nname = "stars only"\nwhy = "lens from the sky"\n[[shot]]\nname = "sky"\nfolder = "sky"\n'
        'kind = "light"\nframes = 4\nmeasure = "star_lens"\n')
    done = calibench("run", session, "--out", tmp_path / "out", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lens = json.loads(done.stdout)["measurements"]["star_lens"]
    assert lens["fx_px"] == pytest.approx(1417.3, abs=1.0)  # the coma of this lens adds 0.64 px to the focal length of stars
    assert read_map(tmp_path / "out" / "calibration.fits").measured == {"intrinsics"}
