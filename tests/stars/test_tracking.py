"""Tracking on rendered frames: honest errors, trails at their middle, a wrong or lost field never answered."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import erf

from calibench.calmap.windows import WindowLayers
from calibench.geometry import projection
from calibench.io.star_table import load_star_table
from calibench.records import DEFECT_FLAGS, SPOT_FLAGS, CalibrationMap, Frame, Intrinsics, Observer, PsfMap
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.stars.tracking import kernels
from calibench.stars.tracking.expected import Expecting
from calibench.stars.tracking.tracker import Tracker

SIZE = (752, 480)
SHAPE = SIZE[::-1]
SIGMA_PX, GAIN = 0.9, 0.1
LENS = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=379.0, cy_px=236.0, distortion=[-0.37, 0.31, -1e-3, 3e-4],
                  image_size_px=SIZE, covariance=np.diag([.04, .04, .01, .01, 1e-8, 1e-8, 1e-12, 1e-12]))
PSF = PsfMap(model="gaussian", degree=0, coefficients=np.array([[SIGMA_PX**2], [SIGMA_PX**2], [0.0]]), image_size_px=SIZE,
             centre="", measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
LAYERS = frozenset({"offset_dn", "read_noise_dn", "gain_dn_per_e", "psf", "intrinsics"})
MAP = CalibrationMap(image_size_px=SIZE, measured=LAYERS, offset_dn=np.full(SHAPE, 64, np.float32),
                     read_noise_dn=np.ones(SHAPE, np.float32), gain_dn_per_e=GAIN, psf=PSF, intrinsics=LENS)


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    table = load_star_table()
    return SkyCatalogue.seen_by(table.take(table.hp_mag <= 6.5), Observer())


def pixels(at, sigma):
    """Share of the light of a Gaussian that the 15 pixels about round(at) take."""
    i = round(at) + np.arange(-7, 8)
    return i, 0.5 * (erf((i + 0.5 - at) / sigma / 2**0.5) - erf((i - 0.5 - at) / sigma / 2**0.5))


def light_of(places, flux_dn):
    """(H, W) DN of point sources (K, 2)."""
    light = np.zeros((SHAPE[0] + 16, SHAPE[1] + 16))
    for (x, y), flux in zip(places, np.broadcast_to(flux_dn, len(places)), strict=True):
        (i, along), (j, down) = pixels(x, SIGMA_PX), pixels(y, SIGMA_PX)
        if i[0] >= -8 and j[0] >= -8 and i[-1] < SIZE[0] + 8 and j[-1] < SIZE[1] + 8:
            light[np.ix_(j + 8, i + 8)] += flux * np.outer(down, along)
    return light[8:-8, 8:-8]


def exposed(light_dn, rng, exposure_s=0.1):
    data = rng.poisson(light_dn / GAIN + 50) * GAIN + 64 + rng.normal(0, 1, SHAPE)
    return Frame(data=np.clip(np.round(data), 0, 4095).astype(np.uint16), kind="light", bit_depth=12, white_level_dn=4095.0,
                 exposure_s=exposure_s)


def view(sky, matrix, rng, rate=(0.0, 0.0, 0.0), exposure_s=0.1, lens=LENS, least_smear_px=0.7):
    """A frame of the sky at mid-exposure attitude `matrix`, turning at `rate` (camera axes); as at one instant where stars move
    by less than least_smear_px."""
    smeared = np.linalg.norm(rate) * exposure_s * lens.fx_px > least_smear_px
    instants = (np.arange(15) + 0.5) / 15 - 0.5 if smeared else [0.0]
    light = np.zeros(SHAPE)
    for instant in instants:
        turn = Rotation.from_rotvec(-np.array(rate) * instant * exposure_s).as_matrix()
        xy = projection.project(lens, sky.directions @ (turn @ matrix).T)
        on = ((xy > -6) & (xy < np.add(SIZE, 5))).all(1)
        light += light_of(xy[on], 3e5 * 10 ** (-0.4 * sky.magnitude[on]) / len(instants))
    return exposed(light, rng, exposure_s)


def tracker(sky):
    return Tracker(sky=sky, calmap=MAP, lens=LENS, calibrated=True)


def quaternion(matrix):
    return Rotation.from_matrix(matrix).as_quat()


@pytest.mark.parametrize(("rate_deg_s", "exposure_s", "frames"), [((0.05, 0.03, 0.1), 0.1, 40), ((1.0, 0.5, 2.0), 0.1, 12)])
def test_a_turning_camera_is_followed_honestly(sky, rate_deg_s, exposure_s, frames):
    """Slow: points. 1.1 degrees a second across, 2 in roll: trails of 2 to 4 px, whose middle is the mid-exposure."""
    rng, rate, dt = np.random.default_rng(51), np.radians(rate_deg_s), 0.1
    truth = Rotation.random(random_state=52).as_matrix()
    turn = Rotation.from_rotvec(-rate * dt).as_matrix()
    attitudes = [truth := turn @ truth for _ in range(frames)]
    track, squares = None, []
    for k, truth in enumerate(attitudes):
        frame = view(sky, truth, rng, rate, exposure_s)
        track = track or tracker(sky)
        if k < 2:
            track.start(quaternion(truth), k * dt)
            continue
        spots, found, attitude = track.follow(frame, k * dt, Observer())
        assert attitude.status == "solved" and found.false_match_probability < 1e-6
        error = Rotation.from_matrix(truth @ Rotation.from_quat(attitude.q_cam_icrs).as_matrix().T).as_rotvec()
        squares.append(error**2 / np.diag(attitude.covariance_rad2))
        assert np.abs(error[:2]).max() * 206265 < 3
    np.testing.assert_allclose(track.rate_rad_s, rate, atol=np.radians(0.02))
    assert np.mean(squares) < 1.7  # trails at 15 instants are not quite even: their error bars come out wide
    if frames == 40:
        assert np.mean(squares) > 0.6


def test_a_jump_is_lost_and_never_wrong(sky):
    """Another field, clouds, hot pixels: rejected with the reason."""
    rng = np.random.default_rng(53)
    truth = Rotation.random(random_state=54).as_matrix()
    first = view(sky, truth, rng)
    hot = exposed(light_of(rng.uniform(0, SIZE, (4000, 2)), 300.0), rng)
    clouds = exposed(np.zeros(SHAPE), rng)
    elsewhere = [view(sky, Rotation.random(random_state=s).as_matrix(), rng) for s in range(60, 64)]
    for frame in (hot, clouds, *elsewhere):
        track = tracker(sky)
        track.start(quaternion(truth), 0.0)
        _, found, attitude = track.follow(frame, 1.0, Observer())
        assert attitude.status == "rejected" and attitude.reason.startswith("track lost")
        assert found.false_match_probability >= 1e-6
    assert track.follow(first, 2.0, Observer())[2].status == "solved"  # the place is kept: the field may come back


def test_a_drifting_focus_is_followed(sky):
    """The lens has grown by 0.1 % since the map was made: the track finds it, with an error bar that holds it."""
    rng = np.random.default_rng(55)
    truth = Rotation.random(random_state=56).as_matrix()
    now = Intrinsics(**{**vars(LENS), "fx_px": LENS.fx_px * 1.001, "fy_px": LENS.fy_px * 1.001})
    track = None
    for k in range(20):
        frame = view(sky, truth, rng, lens=now)
        track = track or tracker(sky)
        track.start(quaternion(truth), 0.0) if k == 0 else track.follow(frame, float(k), Observer())
    sd = np.sqrt(track.drift.covariance[0, 0])
    assert abs(track.drift.state[0] - 1e-3) < 4 * sd and sd < 2e-4
    assert track.drift.applied_to(LENS).fx_px == pytest.approx(now.fx_px, rel=3e-4)


def windows(frame, places, trail=(0.0, 0.0), calmap=MAP):
    """Which of the places show a spot, and the spots."""
    return Expecting(calmap=calmap).measure(frame.data, WindowLayers.of(frame, calmap), np.asarray(places, float),
                                            np.tile(np.asarray(trail, float), (len(places), 1)), 4)


def test_windows_measure_points_to_their_error_bars():
    rng = np.random.default_rng(57)
    truth = np.stack(np.meshgrid(np.arange(30, 730, 35), np.arange(30, 460, 35)), -1).reshape(-1, 2) + rng.uniform(
        -0.5, 0.5, (260, 2))
    seen, spots = windows(exposed(light_of(truth, 2000.0), rng), truth + rng.uniform(-3, 3, truth.shape))
    assert len(seen) == len(truth)
    z2 = (spots.xy_px - truth) ** 2 / np.einsum("nii->ni", spots.covariance_px2)
    assert 0.8 < z2.mean() < 1.25
    assert spots.flux_e.mean() == pytest.approx(2000 / GAIN, rel=0.01)


def test_windows_find_the_middle_of_a_trail_and_refuse_defects():
    rng = np.random.default_rng(58)
    truth = np.stack(np.meshgrid(np.arange(40, 720, 60), np.arange(40, 450, 60)), -1).reshape(-1, 2) + 0.3
    trail = np.array([7.0, -4.0])
    light = sum(light_of(truth + trail * s, 4000.0 / 40) for s in (np.arange(40) + 0.5) / 40 - 0.5)
    frame = exposed(light, rng)
    seen, spots = windows(frame, truth + rng.uniform(-2, 2, truth.shape), trail)
    assert len(seen) == len(truth) and (spots.flags & SPOT_FLAGS["trail"]).all()
    z2 = (spots.xy_px - truth) ** 2 / np.einsum("nii->ni", spots.covariance_px2)
    assert 0.6 < z2.mean() < 1.5
    assert np.sqrt(((spots.xy_px - truth) ** 2).mean()) < 0.05
    bad = np.zeros(SHAPE, np.uint16)
    bad[round(truth[0, 1]), round(truth[0, 0])] = DEFECT_FLAGS["hot"]
    holed = dataclasses.replace(MAP, measured=MAP.measured | {"defects"}, defects=bad)
    assert len(windows(frame, truth[:1], trail, holed)[0]) == 0
    assert len(windows(exposed(np.zeros(SHAPE), rng), truth)[0]) == 0


def test_compiled_prediction_and_fit_match_their_plain_form(sky):
    rng = np.random.default_rng(59)
    matrix = Rotation.random(random_state=60).as_matrix()
    camera = np.array([LENS.fx_px, LENS.fy_px, LENS.cx_px, LENS.cy_px, 1.0])
    terms = np.append(LENS.distortion, np.zeros(8))
    rows, xy, by_v = kernels.predict(sky.directions, matrix, camera, terms, projection.fold_radius(LENS), *SIZE, 5, 500)
    u = sky.directions[rows] @ matrix.T
    theirs, by_theirs, by_p = projection.project_with_jacobian(LENS, u)
    np.testing.assert_allclose(xy, theirs, atol=1e-9)
    np.testing.assert_allclose(by_v, by_theirs, atol=1e-6)
    every = projection.project(LENS, sky.directions @ matrix.T)
    assert len(rows) == ((every > 5) & (every < np.array(SIZE) - 6)).all(1).sum()
    sd = rng.uniform(0.05, 0.3, len(rows))
    covariance = np.stack([sd**2, sd**2 * 1.5, sd**2 * 0.3], -1)
    v = projection.unproject(LENS, xy + rng.normal(size=xy.shape) * sd[:, None])
    start = Rotation.from_rotvec([1e-3, -1e-3, 2e-3]).as_matrix() @ matrix
    agreeing, residual, by_turn, weight = kernels.fit_track(v, sky.directions[rows], by_v, covariance, 0.03,
                                                            np.full(len(rows), 10.0), 4, start)
    assert agreeing.all() and Rotation.from_matrix(start @ matrix.T).magnitude() < 2e-4
    full = np.stack([covariance[:, [0, 2]], covariance[:, [2, 1]]], 1)
    w = np.linalg.inv(full + np.eye(2) * 0.03**2)
    np.testing.assert_allclose(weight, np.stack([w[:, 0, 0], w[:, 1, 1], w[:, 0, 1]], -1), rtol=1e-9)
    normal = np.swapaxes(by_turn, 1, 2) @ w
    assert np.abs(np.einsum("mij,mj->i", normal, residual)).max() < 1e-6 * np.abs(normal).sum()  # nothing left to gain
    spread, chi2, information, gradient = kernels.spread_of(residual, by_turn, weight, covariance, xy,
                                                            np.array([LENS.cx_px, LENS.cy_px]))
    gain = np.linalg.inv((normal @ by_turn).sum(0))
    np.testing.assert_allclose(spread, gain @ (normal @ full @ np.swapaxes(normal, 1, 2)).sum(0) @ gain, rtol=1e-8)
    assert chi2 == pytest.approx(np.einsum("mi,mij,mj->", residual, np.linalg.inv(full), residual))
    by_lens = np.stack([by_p[..., 0] * LENS.fx_px + by_p[..., 1] * LENS.fy_px, by_p[..., 2], by_p[..., 3]], -1)
    mixed = (np.swapaxes(by_lens, 1, 2) @ w @ by_turn).sum(0)
    expected = (np.swapaxes(by_lens, 1, 2) @ w @ by_lens).sum(0) - mixed @ gain @ mixed.T
    np.testing.assert_allclose(information, expected, rtol=1e-4)
    assert gradient.shape == (3,)
