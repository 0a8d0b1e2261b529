"""Frame stacks: cost of accumulation, of a frame from disk to sums, and memory and time of whole commands. `make bench`.

CPU time of this process or of the command, medians. 5 Mpx is 2592 x 1944. The commands run on 302 frames in a temporary folder
(3 GB; set CALIBENCH_BENCH_FRAMES to fewer).
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import tifffile

from calibench.io.frame_series import FrameSeries
from calibench.io.frames import read_frame
from calibench.measure import dark
from calibench.measure._dark.darkness import check_dark
from calibench.measure._frames.glance import glance
from calibench.measure._frames.ledger import Ledger
from calibench.measure._frames.stack import BATCH, Accumulator
from calibench.measure.kernels import add_frames
from calibench.records import Frame

SHAPE = (1944, 2592)
MEGABYTES = SHAPE[0] * SHAPE[1] * 2 / 1e6
FRAMES = int(os.environ.get("CALIBENCH_BENCH_FRAMES", "302"))
LAYOUT = f'width = {SHAPE[1]}\nheight = {SHAPE[0]}\ndtype = "uint16"\nendianness = "little"\n'
LEVELS = 50


def cpu_ms(work, repeats: int = 9) -> float:
    """Median CPU time of `work`, ms."""
    work()
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        spent.append(1e3 * (time.process_time() - start))
    return float(np.median(spent))


def noises(count: int = 8, noise_dn: float = 4.0) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.normal(0, noise_dn, SHAPE).astype(np.float32) for _ in range(count)]


def of_noise(noise: list[np.ndarray], i: int, level_dn: float, scale: float = 1.0) -> np.ndarray:
    """A frame whose noise no other has: the given noise, moved."""
    moved = np.roll(noise[i % len(noise)], (37 * i, 53 * i), axis=(0, 1))
    return np.rint(level_dn + scale * moved).clip(0, 4095).astype(np.uint16)


def test_accumulation():
    frames = [of_noise(noises(), i, 800) for i in range(BATCH)]
    for data in frames:
        data.flags.writeable = False
    flat = tuple(data.reshape(-1) for data in frames)
    pixels, weights = flat[0].size, np.arange(BATCH, dtype=np.int32)
    total, squares, weighted = np.zeros(pixels, np.int32), np.zeros(pixels, np.int64), np.zeros(pixels, np.int64)
    sums = cpu_ms(lambda: add_frames(flat, BATCH, weights, total, squares, weighted)) / BATCH
    reading = cpu_ms(lambda: frames[0].max())
    plain, plain_sq = np.zeros(SHAPE), np.zeros(SHAPE)

    def two_sums() -> None:
        values = frames[0].astype(np.float64)
        np.add(plain, values, out=plain)
        np.add(plain_sq, values * values, out=plain_sq)
    numpy_ms = cpu_ms(two_sums, 5)
    print(f"\nthree exact sums {sums:.2f} ms a frame, {MEGABYTES / sums:.1f} GB/s; one np.max pass {reading:.2f} ms "
          f"(x {sums / reading:.1f}); numpy, two float sums {numpy_ms:.1f} ms (x {numpy_ms / sums:.0f} slower)")
    seen = [Frame(data=data, bit_depth=12, white_level_dn=4095, kind="dark") for data in frames[:2]]
    turn = iter(range(10**6))
    print(f"glance {cpu_ms(lambda: glance(seen[next(turn) % 2])):.2f} ms, with the check for darkness "
          f"{cpu_ms(lambda: check_dark(seen[next(turn) % 2])):.2f} ms")
    assert int(total.astype(np.int64).sum()) % int(sum(f.sum(dtype=np.int64) for f in frames)) == 0


@pytest.mark.parametrize("suffix", ["tif", "raw"])
def test_from_disk_to_sums(tmp_path, suffix):
    noise, count = noises(4), 40
    said = LAYOUT + 'bit_depth = 12\nkind = "dark"\nexposure_s = 0.1\n'
    for i in range(count):
        path, data = tmp_path / f"{i:03d}.{suffix}", of_noise(noise, i, 800)
        path.write_bytes(data.tobytes()) if suffix == "raw" else tifffile.imwrite(path, data)
        path.with_name(path.name + ".toml").write_text(said if suffix == "raw" else said.replace(LAYOUT, ""))
    paths = sorted(tmp_path.glob(f"*.{suffix}"))
    raw = paths[0].read_bytes()
    hashing = cpu_ms(lambda: hashlib.sha256(raw).hexdigest())

    def once(known: str) -> tuple[float, float]:
        ledger, stack = Ledger(dark.Settings(), "darks"), Accumulator()
        start, wall = time.process_time(), time.perf_counter()
        for frame in FrameSeries(paths, lambda path, sha256: read_frame(path, sha256=f"{known}{path.name}" if known else "")):
            check_dark(frame)
            assert ledger.take(frame)
            stack.add(frame)
        stack.series()
        return 1e3 * (time.process_time() - start) / count, 1e3 * (time.perf_counter() - wall) / count
    once("warm")
    (cpu, wall), (unhashed, _) = once(""), once("known")
    print(f"\n{suffix}: open, hash, decode, check, accumulate {cpu:.1f} ms CPU a frame, {wall:.1f} ms by the clock; "
          f"{unhashed:.1f} ms without hashing; sha256 alone {hashing:.1f} ms")


@pytest.fixture(scope="module")
def series(tmp_path_factory) -> Path:
    """302 frames of 5 Mpx: a ladder of 50 levels with two bright and two dark frames each, and two stacks of 51."""
    folder, noise = tmp_path_factory.mktemp("series"), noises()
    lines, default, count = [f"n 12 {SHAPE[1]} {SHAPE[0]}"], [], iter(range(10**6))

    def add(kind: str, exposure_ms: float, photons: float, repeats: int) -> None:
        lines.append(f"b {1e6 * exposure_ms:.0f} {photons}" if kind == "flat" else f"d {1e6 * exposure_ms:.0f}")
        for _ in range(repeats):
            i = next(count)
            if i >= FRAMES:
                return
            name = f"{kind}_{i:04d}.tif"
            level, scale = 100 + 0.25 * photons, float(np.sqrt(0.25**2 * photons + 16 / 16)) / 4
            tifffile.imwrite(folder / name, of_noise(noise, i, level, scale if kind == "flat" else 1.0))
            lines.append(f"i {name}")
            default.append(f'[files."{name}"]\nkind = "{kind}"\nexposure_s = {exposure_ms / 1e3}\nbit_depth = 12\n')
    add("flat", 25, 8000.0, 51)
    add("dark", 25, 0.0, 51)
    for i in range(LEVELS):
        add("flat", 1 + i, 330.0 * (1 + i), 2)
        add("dark", 1 + i, 0.0, 2)
    (folder / "descriptor.txt").write_text("\n".join(lines) + "\n")
    (folder / "frames.toml").write_text("".join(default))
    return folder


@pytest.mark.parametrize("command", ["transfer --descriptor {series}/descriptor.txt", "flat {flats}", "dark {darks}"])
def test_memory_and_time_of_a_command(series, tmp_path, command):
    stack = sorted(series.glob("*_00*.tif")) + sorted(series.glob("*_010[01].tif"))
    darks = sorted(series.glob("dark*.tif"))
    folders = {"flats": [(path, 0.025) for path in stack],  # one level of light and its darks
               "darks": [(path, (0.1, 0.5, 2.0, 8.0)[4 * i // len(darks)]) for i, path in enumerate(darks)]}
    for name, frames in folders.items():
        (tmp_path / name).mkdir()
        said = ["[default]\nbit_depth = 12\n"]
        for path, exposure_s in frames:
            os.link(path, tmp_path / name / path.name)
            said.append(f'[files."{path.name}"]\nkind = "{path.name[:4]}"\nexposure_s = {exposure_s}\n')
        (tmp_path / name / "frames.toml").write_text("".join(said))
    script = ("import resource, sys, time; from calibench.cli.app import app\n"
              "try: app(sys.argv[1:], standalone_mode=False)\n"
              "finally:\n"
              "    peak = next(line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM'))\n"
              "    u = resource.getrusage(resource.RUSAGE_SELF)\n"  # its ru_maxrss would be at least that of the parent
              "    print(f'{u.ru_utime + u.ru_stime:.1f} CPU s, peak {int(peak) / 1024:.0f} MB', file=sys.stderr)")
    words = command.format(series=series, flats=tmp_path / "flats", darks=tmp_path / "darks").split()
    begun = time.perf_counter()
    run = subprocess.run([sys.executable, "-c", script, *words, "--json"], capture_output=True, text=True)
    print(f"\n{words[0]}: {run.stderr.strip().splitlines()[-1]}, {time.perf_counter() - begun:.1f} s by the clock")
    assert run.returncode == 0, run.stderr
