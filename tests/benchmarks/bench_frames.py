"""Frames a second of a series in memory, 752 x 480, map applied: solved lost in space, and tracked. `make bench`.

CPU time of this process, one core, medians; reading is excluded. The field is rendered, of stars to two magnitudes.
"""

from __future__ import annotations

import importlib.util
import os
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench.geometry import projection
from calibench.io.star_table import load_star_table
from calibench.records import Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.stars.solve import Solver

PATH = Path(__file__).parents[1] / "stars" / "test_tracking.py"
FRAMES, ROUNDS, STEP_S, TRAILED = 30, 8, 0.1, 40


def rendered(faintest_mag=6.5):
    """The module that renders, the sky drawn, and the frames of a slow turn with their attitudes."""
    spec = importlib.util.spec_from_file_location("render", PATH)
    render = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(render)
    table = load_star_table()
    sky, rng = SkyCatalogue.seen_by(table.take(table.hp_mag <= faintest_mag), Observer()), np.random.default_rng(6)
    truth, turn = Rotation.random(random_state=52).as_matrix(), Rotation.from_rotvec([-8.7e-5, -5.2e-5, -1.7e-4]).as_matrix()
    attitudes = [truth := turn @ truth for _ in range(FRAMES)]
    return render, sky, attitudes, [render.view(sky, one, rng) for one in attitudes]


@pytest.mark.parametrize("faintest_mag", [5.0, 6.5])
def test_frames_a_second(faintest_mag):
    render, sky, attitudes, frames = rendered(faintest_mag)
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
    print(f"\n{len(solution.spots)} spots, load {load:.1f} a core; stages detect, identify, attitude "
          f"{np.median(stages, 0) * 1e3} ms of wall time")
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


@pytest.mark.parametrize("rate_deg_s", [0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0])
def test_error_bars_of_trailed_stars(rate_deg_s):
    """Stars drawn out during 0.1 s, the camera turning across its boresight: attitude at mid-exposure and its covariance."""
    render, sky, _, _ = rendered()
    rng, exposure_s, squares, places, lost = np.random.default_rng(12), 0.1, [], [], 0
    for seed in range(TRAILED):
        rate = np.radians(rate_deg_s) * Rotation.random(random_state=seed).apply([1.0, 0, 0]) * [1, 1, 0]
        length = np.linalg.norm(rate)
        rate = rate * np.radians(rate_deg_s) / length if length > 0 else rate
        truth = Rotation.random(random_state=100 + seed).as_matrix()
        before = [Rotation.from_rotvec(rate * STEP_S * back).as_matrix() @ truth for back in (2, 1)]
        track = render.tracker(sky)
        for k, matrix in enumerate(before):
            track.start(render.quaternion(matrix), k * STEP_S)
        frame = render.view(sky, truth, rng, rate, exposure_s, least_smear_px=0)
        _, found, attitude = track.follow(frame, 2 * STEP_S, Observer())
        if attitude.status != "solved":
            lost += 1
            continue
        error = Rotation.from_matrix(truth @ Rotation.from_quat(attitude.q_cam_icrs).as_matrix().T).as_rotvec()
        squares.append(error @ np.linalg.solve(attitude.covariance_rad2, error) / 3)
        off = found.xy_px - projection.project(render.LENS, found.direction_icrs @ truth.T)
        places.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(found.covariance_px2), off) / 2)
    of_spots = np.concatenate(places)
    print(f"\n{rate_deg_s} deg/s, trails of {np.radians(rate_deg_s) * exposure_s * render.LENS.fx_px:.2f} px: {len(squares)} "
          f"frames, {lost} lost; normalised error squared of the attitude {np.mean(squares):.2f} +- "
          f"{np.std(squares) / len(squares)**0.5:.2f}, of {len(of_spots)} spots {of_spots.mean():.2f}")
    assert lost == 0 and 0.7 < np.mean(squares) < 1.4
