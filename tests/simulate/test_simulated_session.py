"""The rendered session: what is in it, that its truth is true, that it repeats and stays small."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter

import cv2
import numpy as np
import pytest

from calibench.geometry.projection import project, unproject
from calibench.geometry.rotation import matrix_from_quaternion
from calibench.geometry.sphere import aberrate, unit_from_radec
from calibench.records import Observer, StarTable
from calibench.simulate.camera import thesis_camera
from calibench.simulate.session import RenderedFrame, SessionPlan, render_session, sample_plan, thesis_plan
from calibench.simulate.truth import camera_truth

CAMERA = thesis_camera(1)
VELOCITY_C = np.array([5e-5, -8e-5, 2e-5])


def sky(n: int = 4000) -> StarTable:
    rng = np.random.default_rng(1)
    v = rng.standard_normal((n, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    zero, mag = np.zeros(n), rng.uniform(2, 7, n)
    return StarTable(epoch_jyear=2000.0, hip=np.arange(1, n + 1), hr=np.zeros(n, int), ra_rad=np.arctan2(v[:, 1], v[:, 0]),
                     dec_rad=np.arcsin(v[:, 2]), pm_ra_mas_yr=zero, pm_dec_mas_yr=zero, parallax_mas=zero, hp_mag=mag,
                     v_mag=mag, b_v=zero, spectral_type=np.array([""] * n))


def observer_at(date_obs: str) -> Observer:
    return Observer(epoch_jyear=float(date_obs[:4]), velocity_c=VELOCITY_C, dated=True)


def render(plan: SessionPlan, seed: int = 5) -> list[RenderedFrame]:
    return list(render_session(CAMERA, sky(), plan, seed=seed, observer_at=observer_at))


def small(**changes: object) -> SessionPlan:
    return dataclasses.replace(sample_plan(), **{"board_views": 1, "darks": ((0.0001, 1), (0.2, 1)), "flats": ((0.02, 1),),
                                                 "spot_frames": 1, "sky": sample_plan().sky[:1]} | changes)


@pytest.fixture(scope="module")
def frames() -> list[RenderedFrame]:
    return render(small())


def test_every_frame_tells_what_a_reader_needs(frames):
    for rendered in frames:
        frame = rendered.frame
        assert frame.file == rendered.path and frame.image_size_px == (752, 480)
        assert (frame.bit_depth, frame.white_level_dn, frame.gain_setting) == (10, 1023, 4.0)
        assert frame.camera == "MT9V022 (simulated)" and frame.temperature_c == 25.0 and frame.exposure_s > 0
    assert [(r.path, r.frame.kind, r.truth["scene"]) for r in frames] == [
        ("boards/board_01.png", "light", "board"), ("darks/dark_0.1ms_01.png", "dark", "dark"),
        ("darks/dark_200ms_01.png", "dark", "dark"), ("flats/flat_20ms_01.png", "flat", "flat"),
        ("spots/spots_01.png", "light", "spots"), ("sky/sky_01_orion.png", "light", "sky")]
    assert [r.frame.date_obs for r in frames] == [None] * 5 + ["2025-01-18T20:14:00"]


def test_the_seed_repeats_a_session_and_one_more_frame_changes_no_other(frames):
    again = {r.path: r for r in render(small(darks=((0.0001, 2), (0.2, 1)), spot_frames=2))}
    for rendered in frames:
        assert np.array_equal(rendered.frame.data, again[rendered.path].frame.data)
        assert rendered.truth == again[rendered.path].truth
    other = render(small(), seed=6)
    assert not any(np.array_equal(a.frame.data, b.frame.data) for a, b in zip(frames, other, strict=True))


def test_truth_is_plain_and_names_the_camera(frames):
    truth = camera_truth(CAMERA) | {"frames": {r.path: r.truth for r in frames}}
    assert json.loads(json.dumps(truth, allow_nan=False)) == truth
    assert truth["intrinsics"]["distortion"]["k1"] == -0.37
    assert truth["sensor"]["gain_dn_per_e"] == 0.1
    x, y, rate = truth["defects"]["hot"][0]
    assert CAMERA.pattern.dark_rate_e_per_s[y, x] == pytest.approx(rate, abs=1e-3)


def test_sky_truth_closes_through_the_lens(frames):
    truth = frames[-1].truth
    r_cam_icrs = matrix_from_quaternion(np.array(truth["q_cam_icrs"]))
    centre = unit_from_radec(np.radians(truth["ra_deg"]), np.radians(truth["dec_deg"]))
    assert project(CAMERA.intrinsics, (r_cam_icrs @ aberrate(centre, VELOCITY_C))[None])[0] == pytest.approx([375.5, 239.5])
    # Roll: a point a little to the north of the centre leaves it at the angle -roll from up, counted counter-clockwise.
    north = unit_from_radec(np.radians(truth["ra_deg"]), np.radians(truth["dec_deg"] + 0.01))
    dx, dy = project(CAMERA.intrinsics, (r_cam_icrs @ aberrate(north, VELOCITY_C))[None])[0] - [375.5, 239.5]
    assert np.degrees(np.arctan2(dx, -dy)) == pytest.approx(truth["roll_deg"], abs=0.05)
    stars = sky()
    rows = np.array(truth["hip"]) - 1
    seen = unproject(CAMERA.intrinsics, np.array(truth["stars"])[:, 2:4]) @ r_cam_icrs
    listed = aberrate(unit_from_radec(stars.ra_rad[rows], stars.dec_rad[rows]), VELOCITY_C)
    assert len(rows) > 20 and np.abs(seen - listed).max() < 1e-7


def test_bright_stars_stand_at_their_true_centroids_on_the_frame(frames):
    rendered = frames[-1]
    pattern = CAMERA.pattern
    data = rendered.frame.data - pattern.offset_dn - 0.2 * 0.1 * pattern.dark_rate_e_per_s
    errors = []
    for _, _, x, y, flux_e in rendered.truth["stars"]:
        col, row = round(x), round(y)
        if 2000 < flux_e < 8000 and 7 < col < 744 and 7 < row < 472:
            window = data[row - 2:row + 3, col - 2:col + 3] - np.median(data[row - 7:row + 8, col - 7:col + 8])
            dy, dx = np.mgrid[-2:3, -2:3]
            errors.append([(window * dx).sum() / window.sum() + col - x, (window * dy).sum() / window.sum() + row - y])
    assert len(errors) > 5 and np.abs(np.median(errors, axis=0)).max() < 0.05
    assert np.median(np.abs(errors)) < 0.1


def test_the_sample_is_complete_and_below_fifteen_megabytes(frames):
    plan = sample_plan()
    counts = Counter(boards=plan.board_views, darks=sum(n for _, n in plan.darks), flats=sum(n for _, n in plan.flats),
                     spots=plan.spot_frames, sky=len(plan.sky))
    # The largest PNG of each kind stands for its kind; the longest dark has the most noise.
    largest = Counter()
    for rendered in [*frames, *render(small(board_views=0, darks=((1.0, 1),), flats=(), spot_frames=0, sky=()))]:
        kind = rendered.path.split("/")[0]
        largest[kind] = max(largest[kind], len(cv2.imencode(".png", rendered.frame.data)[1]))
    assert set(largest) == set(counts)
    assert 5e6 < sum(largest[kind] * counts[kind] for kind in counts) < 14e6
    assert plan.darks[0][0] <= 1e-3 and len(plan.darks) >= 4
    assert plan.sky_exposure_s in [t for t, _ in plan.darks]


def test_the_thesis_plan_has_the_thesis_counts():
    plan = thesis_plan()
    assert plan.board_views == 30 and [n for _, n in plan.flats] == [30, 30]
    assert {0.0243, 0.0486, 0.0729} <= {t for t, n in plan.darks if n >= 20}
