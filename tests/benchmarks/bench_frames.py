"""Frames a second of a series in memory, 752 x 480, map applied: solved lost in space, and tracked. `make bench`.

CPU time of this process, one core, medians; reading is excluded. The field is rendered (113 matched stars, 114 spots).
"""

from __future__ import annotations

import importlib.util
import os
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from calibench.io.star_table import load_star_table
from calibench.records import Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.stars.solve import Solver

PATH = Path(__file__).parents[1] / "stars" / "test_tracking.py"
FRAMES, ROUNDS, STEP_S = 30, 8, 0.1


def rendered():
    """The module that renders, the sky drawn, and the frames of a slow turn with their attitudes."""
    spec = importlib.util.spec_from_file_location("render", PATH)
    render = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(render)
    table = load_star_table()
    sky, rng = SkyCatalogue.seen_by(table.take(table.hp_mag <= 6.5), Observer()), np.random.default_rng(6)
    truth, turn = Rotation.random(random_state=52).as_matrix(), Rotation.from_rotvec([-8.7e-5, -5.2e-5, -1.7e-4]).as_matrix()
    attitudes = [truth := turn @ truth for _ in range(FRAMES)]
    return render, sky, attitudes, [render.view(sky, one, rng) for one in attitudes]


def test_frames_a_second():
    render, sky, attitudes, frames = rendered()
    solver = Solver(finder=LostInSpace(sky=SkyCatalogue.seen_by(load_star_table(), Observer())))
    solver.solve(frames[0], render.MAP)
    solving, stages, following = [], [], []
    for _ in range(ROUNDS):
        for frame in frames:
            begin = time.process_time()
            solution = solver.solve(frame, render.MAP)
            solving.append(time.process_time() - begin)
            assert solution.status == "solved"
            stages.append([solution.timings_s[name] for name in ("detect", "identify", "attitude")])
        track = render.tracker(sky)
        for k in (0, 1):
            track.start(render.quaternion(attitudes[k]), k * STEP_S)
        for k in range(2, FRAMES):
            begin = time.process_time()
            *_, attitude = track.follow(frames[k], k * STEP_S, Observer())
            following.append(time.process_time() - begin)
            assert attitude.status == "solved"
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    print(f"\nload {load:.1f} a core; stages detect, identify, attitude {np.median(stages, 0) * 1e3} ms of wall time")
    for name, times in (("solve", solving), ("track", following)):
        print(f"{name}: median {np.median(times) * 1e3:.2f} ms, {1 / np.median(times):.0f} frames/s; the fastest tenth "
              f"{np.quantile(times, 0.1) * 1e3:.2f} ms, {1 / np.quantile(times, 0.1):.0f} frames/s")


def test_a_track_is_never_confidently_wrong():
    """Thousands of steps from a known attitude: on as before, a jump to another field, a small jump, a frame of hot pixels."""
    render, sky, attitudes, frames = rendered()
    rng, steps, wrong, lost, kept = np.random.default_rng(9), 1000, 0, 0, 0
    hot = [render.exposed(render.light_of(rng.uniform(0, render.SIZE, (count, 2)), 300.0), rng) for count in (50, 500, 4000)]
    for _ in range(steps):
        k, jump = int(rng.integers(FRAMES)), int(rng.integers(4))
        turn = [np.zeros(3), rng.normal(0, 0.003, 3), rng.normal(0, 1.0, 3), np.zeros(3)][jump]
        believed = Rotation.from_rotvec(turn).as_matrix() @ attitudes[k]
        track = render.tracker(sky)
        track.start(render.quaternion(believed), 0.0)
        frame = hot[int(rng.integers(3))] if jump == 3 else frames[k]
        *_, attitude = track.follow(frame, 1.0, Observer())
        if attitude.status != "solved":
            lost += 1
            continue
        off = Rotation.from_matrix(Rotation.from_quat(attitude.q_cam_icrs).as_matrix() @ attitudes[k].T).magnitude()
        wrong, kept = wrong + (jump == 3 or off > 1e-3), kept + 1
    print(f"\ntrack: {steps} steps, {kept} answered, {lost} lost, {wrong} wrong")
    assert wrong == 0 and kept > steps / 5
