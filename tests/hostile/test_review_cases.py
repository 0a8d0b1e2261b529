"""Cases that a hostile reading of the first version found: each failed once."""

import json
import shutil
import subprocess
import sys

import cv2
import numpy as np
import pytest

COMMAND = [sys.executable, "-c", "from calibench.cli import main; main()"]


def calibench(*arguments, cwd):
    done = subprocess.run([*COMMAND, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=300)
    assert "Traceback" not in done.stderr, done.stderr
    return done


def without_bit_depth(source, target):
    """The frames of a folder as sidecars that say everything but the converter's bits."""
    shutil.copytree(source, target)
    for sidecar in target.glob("*.toml"):
        kept = [line for line in sidecar.read_text().splitlines() if not line.startswith("bit_depth")]
        sidecar.write_text("\n".join(kept))
    return target


def test_flats_of_unstated_depth_are_not_too_dim(root, tmp_path):
    flats = without_bit_depth(root / "sample_frames" / "flats", tmp_path / "flats")
    darks = without_bit_depth(root / "sample_frames" / "darks", tmp_path / "darks")
    done = calibench("flat", flats, darks, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    gain = json.loads(done.stdout)["quantities"]["gain_dn_per_e"]
    assert gain["value"] == pytest.approx(0.1, abs=5 * gain["uncertainty"])


@pytest.mark.parametrize("folder", ["flats", "sky", "spots", "boards"])
def test_what_is_no_dark_is_no_dark_without_a_word_about_it(root, tmp_path, folder):
    target = tmp_path / folder
    target.mkdir()
    for file in sorted((root / "sample_frames" / folder).glob("*.png"))[:3]:
        shutil.copy(file, target)
    done = calibench("dark", target, "--json", cwd=tmp_path)
    assert done.returncode == 3 and "no dark frame" in done.stderr


def test_constant_frames_are_no_darks(tmp_path):
    np.save(tmp_path / "a.npy", np.full((120, 160), 1023, np.uint16))
    assert calibench("dark", tmp_path / "a.npy", cwd=tmp_path).returncode == 3


def test_a_saturated_flat_is_left_out_by_name(root, tmp_path):
    flats = shutil.copytree(root / "sample_frames" / "flats", tmp_path / "flats")
    bad = sorted(flats.glob("*.png"))[2]
    cv2.imwrite(str(bad), np.full((480, 752), 1023, np.uint16))
    done = calibench("flat", flats, root / "sample_frames" / "darks", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    rejected = json.loads(done.stdout)["frames_rejected"]
    assert [r["file"].rsplit("/", 1)[-1] for r in rejected] == [bad.name] and "saturated" in rejected[0]["reason"]


@pytest.fixture(scope="module")
def sky_map(root, tmp_path_factory):
    out = tmp_path_factory.mktemp("map") / "map.fits"
    boards = root / "sample_frames" / "boards"
    done = calibench("intrinsics", boards, "--board", "9x6", "--square-mm", "25", "--map-out", out, cwd=out.parent)
    assert done.returncode == 0, done.stderr
    done = calibench("dark", root / "sample_frames" / "darks", "--map", out, "--map-out", out, cwd=out.parent)
    assert done.returncode == 0, done.stderr
    return out


def test_a_mirrored_frame_is_solved_with_the_map_and_said(root, tmp_path, sky_map):
    frame = tmp_path / "mirrored.png"
    source = root / "sample_frames" / "sky" / "sky_01_orion.png"
    cv2.imwrite(str(frame), cv2.imread(str(source), cv2.IMREAD_UNCHANGED)[:, ::-1])
    straight, mirrored = (json.loads(calibench("solve", f, "--map", sky_map, "--json", cwd=tmp_path).stdout)["frames"][0]
                          for f in (source, frame))
    assert mirrored["status"] == "solved" and mirrored["mirrored"] and not straight["mirrored"]
    assert mirrored["dec_deg"] == pytest.approx(straight["dec_deg"], abs=0.01)
    assert abs(np.linalg.norm(mirrored["q_cam_icrs"]) - 1) < 1e-12


def test_another_bit_depth_is_outside_the_map(root, tmp_path, sky_map):
    eight = tmp_path / "eight.png"
    data = cv2.imread(str(root / "sample_frames" / "sky" / "sky_01_orion.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(eight), (data >> 2).astype(np.uint8))
    frame = json.loads(calibench("solve", eight, "--map", sky_map, "--json", cwd=tmp_path).stdout)["frames"][0]
    assert frame["map_outside_conditions"] and any("8 bits" in w for w in frame["warnings"])
    assert any("identity was not checked" in w for w in frame["warnings"])
    assert calibench("map", "apply", sky_map, eight, "--out", tmp_path / "o", cwd=tmp_path).returncode == 3


def test_the_map_says_that_the_gain_came_too_late(root, tmp_path, sky_map):
    late = tmp_path / "late.fits"
    done = calibench("flat", root / "sample_frames" / "flats", "--map", sky_map, "--map-out", late, cwd=tmp_path)
    assert done.returncode == 0
    from calibench.io.map_file import read_map
    assert any("run dark again" in warning for warning in read_map(late).warnings)
    assert calibench("dark", root / "sample_frames" / "darks", "--map", late, "--map-out", late, cwd=tmp_path).returncode == 0
    again = read_map(late)
    assert not any("run dark again" in warning for warning in again.warnings)
    assert again.quantities["dark.read_noise_e"].value == pytest.approx(9.85, rel=0.02)


def test_one_unreadable_frame_of_a_folder_does_not_lose_the_others(root, tmp_path):
    sky = shutil.copytree(root / "sample_frames" / "sky", tmp_path / "sky")
    bad = sky / "sky_02_cygnus.png"
    bad.write_bytes(bad.read_bytes()[:5000])
    done = calibench("solve", sky, "--json", cwd=tmp_path)
    frames = json.loads(done.stdout)["frames"]
    assert done.returncode == 1 and [f["status"] for f in frames] == ["solved", "rejected", "solved", "solved"]
    assert "cannot be read" in frames[1]["reason"]
    assert calibench("solve", bad, cwd=tmp_path).returncode == 3


@pytest.mark.parametrize("arguments", [
    ("intrinsics", "x", "--square-mm", "25"), ("solve",), ("solve", "x", "--fov-deg", "0"), ("solve", "x", "--nope"), ("nope",),
    ("simulate", "session", "d", "--seed", "-1"), ("intrinsics", "x", "--board", "0x0", "--square-mm", "25"),
    ("intrinsics", "x", "--board", "99999x9", "--square-mm", "25"), ("new", "d", "--protocol", "foo")])
def test_usage_errors_are_json_too(arguments, tmp_path):
    done = calibench(*arguments, "--json", cwd=tmp_path)
    assert done.returncode == 2
    assert json.loads(done.stdout)["error"]["what"]


def test_a_file_in_the_way_of_a_folder_is_bad_input(root, tmp_path, sky_map):
    (tmp_path / "file").write_text("")
    frame = root / "sample_frames" / "sky" / "sky_01_orion.png"
    for arguments in (("map", "apply", sky_map, frame, "--out", tmp_path / "file"), ("new", tmp_path / "file" / "x")):
        done = calibench(*arguments, "--json", cwd=tmp_path)
        assert done.returncode == 3 and json.loads(done.stdout)["error"]["what"]


def test_contradicting_statements_stop_even_in_a_folder(root, tmp_path):
    darks = shutil.copytree(root / "sample_frames" / "darks", tmp_path / "darks")
    first = sorted(darks.glob("*.png"))[0]
    (darks / "frames.toml").write_text(f'[files."{first.name}"]\nexposure_s = 0.7\n')
    done = calibench("dark", darks, cwd=tmp_path)
    assert done.returncode == 3 and "exposure_s" in done.stderr
