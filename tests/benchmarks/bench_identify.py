"""Star identification at full count: success and CPU beside the peers, frames with nothing to find, the stated odds against the
observed rate, the tables.

    make bench, or: python -m pytest tests/benchmarks/bench_identify.py -s -o python_files='bench_*.py'

CALIBENCH_ATTITUDES: attitudes a case (10,000). CALIBENCH_NOTHING: random spot sets (100,000). A peer is run by the Python of an
environment that has it: CALIBENCH_CEDAR_PYTHON (cedar-solve), CALIBENCH_TETRA3RS_PYTHON (tetra3rs); without, it is skipped.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.geometry import projection
from calibench.io.star_table import load_star_table
from calibench.records import Intrinsics, Observer, Spots
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue

ATTITUDES = int(os.environ.get("CALIBENCH_ATTITUDES", 10_000))
NOTHING = int(os.environ.get("CALIBENCH_NOTHING", 100_000))
PEER_ATTITUDES = 300
SIGMA_PX = 0.2
CAMERAS = {"A": ((1024, 768), 512 / np.tan(np.radians(10))),  # 20 x 15 degrees
           "B": ((752, 480), np.hypot(376, 240) / np.tan(np.radians(15.9)))}  # 31.8 degrees across the diagonal
STRESSES = {"clean": (0, 0.0), "5 false": (5, 0.0), "30 % missing": (0, 0.3), "both": (5, 0.3)}
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


def spots_of(xy: np.ndarray, magnitude: np.ndarray) -> Spots:
    order, n = np.argsort(magnitude), len(xy)
    nothing = np.zeros(n)
    return Spots(xy_px=xy[order], covariance_px2=np.tile(np.eye(2) * SIGMA_PX**2, (n, 1, 1)), flux_e=nothing,
                 background_dn=nothing, peak_dn=nothing, pixels=nothing, flags=nothing)


def look(sky, lens, rng, false: int, missing: float) -> tuple[np.ndarray, Spots]:
    """A random attitude and what the camera sees there."""
    size, truth = np.array(lens.image_size_px), Rotation.random(random_state=rng).as_matrix()
    rows = np.flatnonzero(sky.directions @ truth[2] > 0.9)
    xy = projection.project(lens, sky.directions[rows] @ truth.T)
    on = ((xy > -0.5) & (xy < size - 0.5)).all(1) & (rng.random(len(xy)) >= missing)
    xy = np.concatenate([xy[on] + rng.normal(0, SIGMA_PX, (on.sum(), 2)), rng.uniform(-0.5, size - 0.5, (false, 2))])
    magnitude = np.concatenate([sky.magnitude[rows[on]] + rng.normal(0, 0.2, on.sum()), rng.uniform(2, 6, false)])
    return truth, spots_of(xy, magnitude)


def misses(found, lens, truth) -> bool:
    """Whether the identified stars are not where the truth puts them."""
    there = projection.project(lens, found.direction_icrs @ truth.T)
    return not np.median(np.hypot(*(there - found.xy_px).T)) < 5 * SIGMA_PX


def test_synthetic_skies(sky, tmp_path):
    say(f"\n\n{ATTITUDES} attitudes a case: solved %, wrong, CPU ms mean / median / 99 %")
    shared = []
    for camera in CAMERAS:
        lens, finder = lens_of(camera), LostInSpace(sky=sky)
        for stress, (false, missing) in STRESSES.items():
            rng, solved, wrong, spent = np.random.default_rng(20), 0, 0, []
            frames = [look(sky, lens, rng, false, missing) for _ in range(ATTITUDES)]
            finder.identify(frames[0][1], lens.image_size_px, lens=lens)
            for truth, spots in frames:
                begin = time.process_time_ns()
                found = finder.identify(spots, lens.image_size_px, lens=lens)
                spent.append((time.process_time_ns() - begin) / 1e6)
                solved += found.status == "solved"
                wrong += found.status == "solved" and misses(found, lens, truth)
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


@pytest.mark.parametrize("camera", CAMERAS)
def test_nothing_to_find(sky, camera):
    """Stated probability x against how often a set of random spots is given x or less: never more often than x."""
    lens, rng, finder = lens_of(camera), np.random.default_rng(30), LostInSpace(sky=sky)
    size, stated, begin = np.array(lens.image_size_px), [], time.process_time()
    for _ in range(NOTHING // len(CAMERAS)):
        n = int(rng.integers(5, 31))
        spots = spots_of(rng.uniform(-0.5, size - 0.5, (n, 2)), rng.uniform(2, 6, n))
        found = finder.identify(spots, lens.image_size_px, lens=lens)
        assert found.status != "solved"
        stated.append(found.false_match_probability)
    say(f"\n\n{camera}: {len(stated)} random spot sets, {1e3 * (time.process_time() - begin) / len(stated):.2f} CPU ms each; "
        f"stated probability x, part of the sets with x or less")
    for x in np.logspace(0, -6, 13):
        rate = float(np.mean(np.array(stated) <= x))
        say(f"{x:9.2g}  {rate:.2g}")
        assert rate <= x + 4 * np.sqrt(x / len(stated))


def test_tables(sky):
    full = load_star_table()
    for name, table in (("Hp 6", sky.table), ("Hp 7", full)):
        for camera in CAMERAS:
            finder, lens = LostInSpace(sky=SkyCatalogue.seen_by(table, Observer())), lens_of(camera)
            spots = look(sky, lens, np.random.default_rng(1), 0, 0)[1]
            begin = time.process_time()
            finder.identify(spots, lens.image_size_px, lens=lens)
            spent = time.process_time() - begin
            (made,) = finder.tables.values()
            size = sum(array.nbytes for array in made) / 1e6
            say(f"table of camera {camera} to {name}: {spent:.2f} CPU s with the first frame, {size:.1f} MB, "
                f"{len(made.codes)} groups")
            assert spent < 1 and size < 5
