"""Bad input at the command line: one message, exit 3 (2 for usage), one JSON object, no traceback, nothing half-written."""

import json
import shutil
import subprocess
import sys

import pytest

COMMAND = [sys.executable, "-c", "from calibench.cli import main; main()"]


def calibench(*arguments, cwd):
    return subprocess.run([*COMMAND, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=300)


@pytest.fixture()
def boards(root, tmp_path):
    return shutil.copytree(root / "sample_frames" / "boards", tmp_path / "boards")


def refused(done, code: int, *words: str):
    assert done.returncode == code, done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr, done.stderr


def test_errors_are_one_json_object_too(tmp_path):
    done = calibench("dark", tmp_path / "nowhere", "--json", cwd=tmp_path)
    refused(done, 3, "does not exist")
    assert set(json.loads(done.stdout)["error"]) == {"what", "file", "mend"}


@pytest.mark.parametrize("arguments", [
    ("dark",), ("nonsense",), ("intrinsics", "x", "--board", "nine", "--square-mm", "25"),
    ("solve", "x", "--identify", "stars"), ("solve", "x", "--attitude", "triad2"), ("solve", "x", "--identify", "pyramid"),
    ("simulate", "session", "d", "--plan", "huge"),
    ("intrinsics", "x", "--board", "9x6", "--square-mm", "25", "--model", "brown99")])
def test_usage_is_exit_two(arguments, tmp_path):
    (tmp_path / "x").mkdir()
    refused(calibench(*arguments, cwd=tmp_path), 2)


def test_wrong_board_size_is_told_which_is_right(boards, tmp_path):
    done = calibench("intrinsics", boards, "--board", "8x6", "--square-mm", "25", cwd=tmp_path)
    refused(done, 3, "found 9x6, you said 8x6")


def test_a_named_bad_frame_is_an_error_and_one_in_a_folder_is_left_out(boards, tmp_path):
    bad = boards / "board_03.png"
    bad.write_bytes(bad.read_bytes()[:20000])
    arguments = ("--board", "9x6", "--square-mm", "25", "--json")
    refused(calibench("intrinsics", *sorted(boards.glob("*.png")), *arguments, cwd=tmp_path), 3, "board_03.png")
    done = calibench("intrinsics", boards, *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    values = json.loads(done.stdout)
    assert values["views_used"] == 15 and "board_03.png" in values["frames_rejected"][0]["file"]


def test_darks_that_are_flats_are_refused_and_no_map_appears(root, tmp_path):
    out = tmp_path / "map.fits"
    done = calibench("dark", root / "sample_frames" / "flats", "--map-out", out, cwd=tmp_path)
    refused(done, 3, "flat")
    assert not out.exists()


def test_flats_without_darks_are_refused(root, tmp_path):
    refused(calibench("flat", root / "sample_frames" / "flats", cwd=tmp_path), 3, "dark")


def test_a_damaged_map_and_a_map_of_another_camera_are_refused(root, tmp_path):
    out = tmp_path / "map.fits"
    assert calibench("dark", root / "sample_frames" / "darks", "--map-out", out, cwd=tmp_path).returncode == 0
    raw = bytearray(out.read_bytes())
    raw[len(raw) // 2] ^= 4
    bad = tmp_path / "bad.fits"
    bad.write_bytes(raw)
    sky = root / "sample_frames" / "sky" / "sky_01_orion.png"
    refused(calibench("solve", sky, "--map", bad, cwd=tmp_path), 3, "bad.fits")
    assert calibench("map", "verify", bad, cwd=tmp_path).returncode == 3
    small = tmp_path / "small.npy"
    import numpy as np
    np.save(small, np.zeros((100, 120), np.uint16))
    refused(calibench("solve", small, "--map", out, cwd=tmp_path), 3, "120 x 100", "752 x 480")


def test_outside_the_maps_conditions_apply_refuses_and_force_goes_on(root, tmp_path):
    out = tmp_path / "map.fits"
    assert calibench("dark", root / "sample_frames" / "darks", "--map-out", out, cwd=tmp_path).returncode == 0
    sky = shutil.copy(root / "sample_frames" / "sky" / "sky_01_orion.png", tmp_path / "hot.png")
    sidecar = (root / "sample_frames" / "sky" / "sky_01_orion.png.toml").read_text()
    (tmp_path / "hot.png.toml").write_text(sidecar.replace("temperature_c = 25.0", "temperature_c = 55.0"))
    corrected = tmp_path / "corrected"
    refused(calibench("map", "apply", out, sky, "--out", corrected, cwd=tmp_path), 3, "temperature 55", "--force")
    assert not corrected.exists()
    assert calibench("map", "apply", out, sky, "--out", corrected, "--force", cwd=tmp_path).returncode == 0
    done = calibench("solve", sky, "--map", out, "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["frames"][0]["map_outside_conditions"] is True


def test_a_full_disk_leaves_the_old_map(root, tmp_path):
    out = tmp_path / "map.fits"
    assert calibench("dark", root / "sample_frames" / "darks", "--map-out", out, cwd=tmp_path).returncode == 0
    before = out.read_bytes()
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100000, 100000)); " \
              "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); from calibench.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", limited, "dark", str(root / "sample_frames" / "darks"), "--map-out", str(out)],
                          cwd=tmp_path, capture_output=True, text=True, timeout=300)
    refused(done, 3, "could not be written")
    assert out.read_bytes() == before
    assert [f.name for f in tmp_path.iterdir()] == ["map.fits"]
