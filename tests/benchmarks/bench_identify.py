"""Star identification at full count: success and CPU beside the peers, wrong answers in a million, the stated odds against the
observed rate, the tables.

    make bench, or: python -m pytest tests/benchmarks/bench_identify.py -s -o python_files='bench_*.py'

CALIBENCH_ATTITUDES: attitudes a case (10,000). CALIBENCH_WRONG: attitudes of all cases together among which wrong answers are
counted (100,000). CALIBENCH_NOTHING, CALIBENCH_PART: sets of random spots (100,000), of few stars among false spots (10,000).
CALIBENCH_RESUME: a folder where these counts are kept after each block, so that a run that was stopped goes on where it was.
A peer is run by the Python of an environment that has it: CALIBENCH_CEDAR_PYTHON (cedar-solve), CALIBENCH_TETRA3RS_PYTHON
(tetra3rs); without, it is skipped.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calibench.io.star_table import load_star_table
from calibench.records import Intrinsics, Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.validate.simulated_spots import Condition, is_wrong, look
from calibench.validate.trials import false_match

ATTITUDES = int(os.environ.get("CALIBENCH_ATTITUDES", 10_000))
WRONG = int(os.environ.get("CALIBENCH_WRONG", 100_000))
SETS = {false_match.NOTHING: int(os.environ.get("CALIBENCH_NOTHING", 100_000)),
        false_match.PART: int(os.environ.get("CALIBENCH_PART", 10_000))}
BLOCK = 1000
PEER_ATTITUDES = 300
SIGMA_PX = 0.2
CAMERAS = {"A": ((1024, 768), 512 / np.tan(np.radians(10))),  # 20 x 15 degrees
           "B": ((752, 480), np.hypot(376, 240) / np.tan(np.radians(15.9)))}  # 31.8 degrees across the diagonal
STRESSES = {"clean": Condition(SIGMA_PX, 0, 0.0, 999), "5 false": Condition(SIGMA_PX, 5, 0.0, 999),
            "30 % missing": Condition(SIGMA_PX, 0, 0.3, 999), "both": Condition(SIGMA_PX, 5, 0.3, 999)}
LEAST = {"clean": 0.999, "5 false": 0.999, "30 % missing": 0.999, "both": 0.998}
PEERS = {"cedar-solve": ("CALIBENCH_CEDAR_PYTHON", """
import json, sys, time, numpy as np, tetra3, logging
logging.disable(logging.CRITICAL)
t3, out = tetra3.Tetra3('default_database'), []
for case in json.load(open(sys.argv[1])):
    w, h = case['size']; wide = max(w, h)
    for xy in case['frames']:
        begin = time.process_time()
        f = t3.solve_from_centroids(np.array(xy)[:, ::-1] + 0.5, (h, w), fov_estimate=case['fov_deg'], fov_max_error=0.5)
        out.append((1e3 * (time.process_time() - begin), f['RA'], f['Dec']))
print(json.dumps(out))
"""), "tetra3rs": ("CALIBENCH_TETRA3RS_PYTHON", """
import json, sys, time, numpy as np, tetra3rs
out = []
for case in json.load(open(sys.argv[1])):
    w, h = case['size']
    db = tetra3rs.SolverDatabase.generate_from_gaia(max_fov_deg=case['fov_deg'], star_max_magnitude=7.0)
    for xy in case['frames']:
        xy = np.array(xy) - [(w - 1) / 2, (h - 1) / 2]
        xy = np.concatenate([xy, np.arange(len(xy), 0, -1.0)[:, None]], 1)
        begin = time.process_time()
        f = db.solve_from_centroids(xy, fov_estimate_deg=case['fov_deg'], image_width=w, image_height=h)
        ok = isinstance(f, tetra3rs.SolveResult)
        out.append((1e3 * (time.process_time() - begin), f.ra_deg if ok else None, f.dec_deg if ok else None))
print(json.dumps(out))
""")}


def say(*text) -> None:
    print(*text, file=sys.stderr, flush=True)


def timings(ms: list[float]) -> str:
    return f"{np.mean(ms):.3f} / {np.median(ms):.3f} / {np.quantile(ms, 0.99):.2f}"


def lens_of(camera: str) -> Intrinsics:
    size, focal = CAMERAS[camera]
    return Intrinsics.pinhole(focal_px=focal, image_size_px=size, focal_sd_px=0.0)


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    table = load_star_table()
    return SkyCatalogue.seen_by(table.take(table.hp_mag <= 6.0), Observer())


def tally(name: str, count: int, one: Callable[[np.random.Generator], np.ndarray]) -> tuple[np.ndarray, int]:
    """Sum of what `one` gives for `count` draws, in blocks with a seed each; finished blocks of a stopped run are not run anew.

    Returns the sum, and how many draws it is of.
    """
    kept = Path(os.environ["CALIBENCH_RESUME"]) / f"{name}.jsonl" if "CALIBENCH_RESUME" in os.environ else None
    blocks = [json.loads(line) for line in kept.read_text().splitlines()] if kept and kept.exists() else []
    for block in range(len(blocks), -(-count // BLOCK)):
        rng = np.random.default_rng([*name.encode(), block])
        blocks.append(np.sum([one(rng) for _ in range(BLOCK)], axis=0).tolist())
        if kept:
            with kept.open("a") as file:
                file.write(json.dumps(blocks[-1]) + "\n")
    return np.sum(blocks, axis=0), BLOCK * len(blocks)


def test_synthetic_skies(sky, tmp_path):
    say(f"\n\n{ATTITUDES} attitudes a case: solved %, wrong, CPU ms mean / median / 99 %")
    shared = []
    for camera in CAMERAS:
        lens, finder = lens_of(camera), LostInSpace(sky=sky)
        for stress, condition in STRESSES.items():
            rng, solved, wrong, spent = np.random.default_rng(20), 0, 0, []
            frames = [look(sky, lens, condition, rng) for _ in range(ATTITUDES)]
            finder.identify(frames[0][1], lens.image_size_px, lens=lens)
            for truth, spots in frames:
                begin = time.process_time_ns()
                found = finder.identify(spots, lens.image_size_px, lens=lens)
                spent.append((time.process_time_ns() - begin) / 1e6)
                solved += found.status == "solved"
                wrong += found.status == "solved" and is_wrong(found, truth, SIGMA_PX)
            say(f"{camera} {stress:13s} {100 * solved / ATTITUDES:7.2f}  {wrong}   {timings(spent)}")
            assert wrong == 0 and solved >= LEAST[stress] * ATTITUDES
            w, h = lens.image_size_px
            shared.append({"camera": camera, "stress": stress, "size": (w, h),
                           "fov_deg": float(np.degrees(2 * np.arctan(w / 2 / lens.fx_px))),
                           "frames": [spots.xy_px.tolist() for _, spots in frames[:PEER_ATTITUDES]],
                           "centres": [truth[2].tolist() for truth, _ in frames[:PEER_ATTITUDES]]})
    (tmp_path / "frames.json").write_text(json.dumps(shared))
    for peer, (variable, code) in PEERS.items():
        python = os.environ.get(variable)
        if not python:
            say(f"{peer}: skipped, {variable} does not name a Python that has it")
            continue
        run = subprocess.run([python, "-c", code, str(tmp_path / "frames.json")], capture_output=True, text=True, check=True)
        answers = iter(json.loads(run.stdout.splitlines()[-1]))
        for case in shared:
            spent, solved, wrong = [], 0, 0
            for centre in case["centres"]:
                ms, ra, dec = next(answers)
                spent.append(ms)
                if ra is not None:
                    ra, dec = np.radians([ra, dec])
                    there = (np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec))
                    wrong += bool(np.dot(there, centre) < np.cos(np.radians(0.5)))
                    solved += 1
            say(f"{peer:12s} {case['camera']} {case['stress']:13s} {100 * solved / len(case['centres']):7.2f}  {wrong}   "
                f"{timings(spent)}")


@pytest.mark.parametrize("stress", STRESSES)
@pytest.mark.parametrize("camera", CAMERAS)
def test_no_wrong_answer(sky, camera, stress):
    lens, finder = lens_of(camera), LostInSpace(sky=sky)

    def one(rng: np.random.Generator) -> tuple[bool, bool]:
        truth, spots = look(sky, lens, STRESSES[stress], rng)
        found = finder.identify(spots, lens.image_size_px, lens=lens)
        return found.status == "solved", found.status == "solved" and is_wrong(found, truth, SIGMA_PX)
    (solved, wrong), count = tally(f"wrong {camera} {stress}", WRONG // (len(CAMERAS) * len(STRESSES)), one)
    say(f"{camera} {stress:13s} {count} attitudes, {count - solved} not solved, {wrong} wrong")
    assert wrong == 0


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("camera", CAMERAS)
def test_stated_odds(sky, camera, kind):
    """An answer at a limit of the false-match probability is wrong no oftener than the limit says."""
    finder, lens, tried = LostInSpace(sky=sky), lens_of(camera), false_match.variants(None)[kind]
    counts, sets = tally(f"{kind} {camera}", SETS[kind] // len(CAMERAS), lambda rng: tried(finder, lens, rng))
    say(f"\n\n{camera}, {kind}, {sets} sets: limit, solved, wrong, rate of wrong ones")
    for limit, (solved, wrong) in zip(false_match.LIMITS, counts, strict=True):
        say(f"{limit:9.2g}  {solved}  {wrong}  {wrong / sets:.2g}")
        assert wrong <= limit * sets + 4 * np.sqrt(limit * sets)


def test_tables(sky):
    full = load_star_table()
    for name, table in (("Hp 6", sky.table), ("Hp 7", full)):
        for camera in CAMERAS:
            finder, lens = LostInSpace(sky=SkyCatalogue.seen_by(table, Observer())), lens_of(camera)
            spots = look(sky, lens, STRESSES["clean"], np.random.default_rng(1))[1]
            begin = time.process_time()
            finder.identify(spots, lens.image_size_px, lens=lens)
            spent = time.process_time() - begin
            (made,) = finder.tables.values()
            size = sum(array.nbytes for array in made) / 1e6
            say(f"table of camera {camera} to {name}: {spent:.2f} CPU s with the first frame, {size:.1f} MB, "
                f"{len(made.codes)} groups")
            assert spent < 1 and size < 5
