"""Bad stations, star tables and limits on the command line: one readable message and exit code 3, never a traceback."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest


def calibench(*words: object) -> subprocess.CompletedProcess:
    code = "from calibench.cli.app import main; main()"
    return subprocess.run([sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True)


@pytest.mark.parametrize(("words", "complaint"), [
    (("solve", "a.npy", "--station", "latitude_deg = 99; longitude_deg = 1"), "latitude"),
    (("solve", "a.npy", "--station", "refraction = 'erfa'"), "needs the place"),
    (("solve", "a.npy", "--station", "latitude_deg = 48; longitude_deg = 16"), "no date"),
    (("solve", "a.npy", "--catalogue", "a.npy"), "not a readable star table"),
    (("catalogue", "build", "--out", "t.npz", "--limit-mag", 12, "--fov-deg", 20, "--width-px", 1000), "ends at Hp 7.0"),
    (("catalogue", "build", "--out", "no/such/folder/t.npz", "--fov-deg", 20, "--width-px", 1000), "folder")])
def test_the_answer_is_readable(tmp_path: Path, monkeypatch, words, complaint):
    monkeypatch.chdir(tmp_path)
    np.save("a.npy", np.zeros((48, 64), np.uint16))
    run = calibench(*words)
    assert run.returncode == 3, run.stderr
    assert complaint in run.stderr and "Traceback" not in run.stderr


def test_a_scale_that_nobody_knows_is_a_usage_error():
    run = calibench("catalogue", "build", "--out", "t.npz")
    assert run.returncode == 2 and "--fov-deg" in run.stderr
