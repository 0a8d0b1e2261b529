"""Photon transfer: truth, speed and memory beside the EMVA 1288 reference code. `make bench`.

The reference code (emva1288 1.0.2, needs numpy < 2) runs in an environment of its own, named by CALIBENCH_EMVA1288 (its
python); it is left out where that is not set. CPU time of child processes, with the interpreter's start and the reading.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys

import cv2
import numpy as np
import pytest

K, QE, READ_E, RATE, OFFSET_DN = 0.25, 0.6, 4.0, 20.0, 60.0
TRUTH = {"gain_dn_per_e": K, "quantum_efficiency_percent": 100 * QE, "responsivity_dn_per_photon": K * QE,
         "read_noise_e": READ_E, "dsnu_raw_e": np.sqrt(12.25), "dsnu_raw_row_e": 1.0, "dsnu_raw_column_e": 1.5,
         "dsnu_raw_pixel_e": 3.0,
         "prnu_raw_percent": np.sqrt(1.25), "prnu_raw_row_percent": 0.4, "prnu_raw_column_percent": 0.3,
         "prnu_raw_pixel_percent": 1.0, "dark_current_e_per_s": RATE, "dark_current_from_variance_e_per_s": RATE,
         "offset_dn": OFFSET_DN, "noise_correlation_x": 0.0,
         "absolute_threshold_e": np.sqrt(READ_E**2 + 1 / 12 / K**2 + 0.25) + 0.5}
GOALS = {"gain_dn_per_e": 0.1, "read_noise_e": 0.5, "dsnu_raw_pixel_e": 1.0, "prnu_raw_pixel_percent": 1.0}  # % of the truth
OURS = """
import json, sys
from pathlib import Path
from calibench.io.descriptor import described_frames, read_descriptor
from calibench.measure import transfer
m = transfer.measure(described_frames(read_descriptor(Path(sys.argv[1]))))
print(json.dumps({q.name: (q.value, q.uncertainty) for q in m.quantities}))
"""
THEIRS = """
import json, logging, os, sys
from emva1288.process import loader, parser
from emva1288.process.data import Data1288
from emva1288.process.results import Results1288
logging.disable(logging.CRITICAL)
p = parser.ParseEmvaDescriptorFile(sys.argv[1], path=os.path.dirname(sys.argv[1]))
r = Results1288(Data1288(loader.LoadImageData(p.images).data).data)
names = "K QE R sigma_y_dark sigma_d u_p_min u_p_sat u_e_sat SNR_max DR u_I_mean u_I_var".split()
out = {n: float(getattr(r, n)() if callable(getattr(r, n)) else getattr(r, n)) for n in names}
for n in (f"{what}1288{part}" for what in ("DSNU", "PRNU") for part in ("", "_row", "_col", "_pixel")):
    v = getattr(r, n)
    out[n] = float(v() if callable(v) else v)
print(json.dumps(out))
"""


@pytest.mark.parametrize("size_px", [(752, 480), (2592, 1944)])
def test_truth_speed_and_memory(light_ladder, tmp_path, size_px):
    """302 frames as TIFF: 50 levels in pairs lit and dark, and 51 + 51 in stacks."""
    descriptor = write_series(tmp_path, light_ladder(1, size_px=size_px, levels=50, stack=49), size_px)
    ours, cpu_s, rss_mb = run([sys.executable, "-c", OURS, descriptor])
    ours, cpu_s, rss_mb = run([sys.executable, "-c", OURS, descriptor])  # again, with its kernels compiled
    print(f"\n  {size_px[0]} x {size_px[1]}: {cpu_s:.1f} CPU s, {rss_mb:.0f} MB")
    for name, value in TRUTH.items():
        got, error = ours[name]
        print(f"  {name:38s} {got:10.5g} +- {error:.2g}, truth {value:.5g}")
    reference = os.environ.get("CALIBENCH_EMVA1288")
    if reference:
        theirs, their_cpu_s, their_rss_mb = run([reference, "-c", THEIRS, descriptor])
        print(f"  emva1288: {their_cpu_s:.1f} CPU s ({their_cpu_s / cpu_s:.1f} times ours), {their_rss_mb:.0f} MB\n  {theirs}")
    for name, percent in GOALS.items():
        assert abs(ours[name][0] / TRUTH[name] - 1) < max(percent / 100, 3 * ours[name][1] / TRUTH[name]), name
    assert abs(ours["quantum_efficiency_percent"][0] - 60) < 0.1


def test_real_ccd(real):
    """The same files by both programs; figures differ where release 4 changed the rule."""
    descriptor = str(real / "sensor" / "emva_ccd12_001" / "EMVA1288_Data.txt")
    ours, cpu_s, _ = run([sys.executable, "-c", OURS, descriptor])
    print(f"\n  ours, {cpu_s:.1f} CPU s: {ours}")
    if reference := os.environ.get("CALIBENCH_EMVA1288"):
        theirs, cpu_s, _ = run([reference, "-c", THEIRS, descriptor])
        print(f"  emva1288, {cpu_s:.1f} CPU s: {theirs}")
    assert abs(ours["gain_dn_per_e"][0] - 0.2773) < ours["gain_dn_per_e"][1]


def write_series(folder, frames, size_px):
    """TIFF files and their descriptor; its path."""
    lines, last = [f"n 12 {size_px[0]} {size_px[1]}"], None
    for frame in frames:
        block = frame.file.rsplit("_", 1)[0]
        stack = frame.file[-2:] > "01"
        if (block, stack) != last:
            t_ns = round(frame.exposure_s * 1e9) + stack * (frame.file[-2:] == "02")  # the stack is a block of its own
            lines.append(f"b {t_ns} {frame.photons_per_px:.6f}" if frame.kind == "flat" else f"d {t_ns}")
            last = block, stack
        cv2.imwrite(str(folder / f"{frame.file}.tif"), frame.data, (cv2.IMWRITE_TIFF_COMPRESSION, 1))
        lines.append(f"i {frame.file}.tif")
    (folder / "series.txt").write_text("\n".join(lines) + "\n")
    return str(folder / "series.txt")


def run(command):
    """Answer, CPU seconds and largest memory in MB of a child process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    code = "import resource, subprocess, sys; r = subprocess.run(sys.argv[1:], capture_output=True, text=True); " \
           "print(r.stdout + r.stderr[-3000:] * bool(r.returncode)); " \
           "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(r.returncode)"
    done = subprocess.run([sys.executable, "-c", code, *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    answer, memory = done.stdout.strip().rsplit("\n", 1)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return json.loads(answer.strip().splitlines()[-1]), cpu_s, int(memory) / 1024
