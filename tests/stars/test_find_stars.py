"""The fast path: spots of a raw frame as from the corrected one, the carried threshold map and its rule, false alarms."""

import numpy as np
import pytest
from scipy.special import erf

from calibench.calmap.correct import correct
from calibench.records import DEFECT_FLAGS, SPOT_FLAGS, CalibrationMap, Frame, PsfMap
from calibench.spots.find import find_spots
from calibench.stars.find_stars import FindState, find_stars

SHAPE, GAIN, READ_DN, EXPOSURE_S, SIGMA = (360, 480), 0.5, 2.0, 0.1, 0.8
LAYERS = frozenset(("offset_dn", "dark_rate_dn_per_s", "response", "read_noise_dn", "defects", "gain_dn_per_e", "psf"))


@pytest.fixture(scope="module")
def calmap():
    rng = np.random.default_rng(1)
    dark = rng.exponential(20, SHAPE)
    hot = rng.random(SHAPE) < 1e-3
    dark[hot] += rng.exponential(4000, hot.sum())
    layers = {"offset_dn": rng.normal(60, 2, SHAPE), "dark_rate_dn_per_s": dark, "response": rng.normal(1, 0.01, SHAPE),
              "read_noise_dn": np.full(SHAPE, READ_DN)}
    return CalibrationMap(image_size_px=SHAPE[::-1], measured=LAYERS, gain_dn_per_e=GAIN,
                          psf=PsfMap.unknown(SHAPE[::-1], SIGMA), defects=(hot * DEFECT_FLAGS["hot"]).astype(np.uint16),
                          **{name: layer.astype(np.float32) for name, layer in layers.items()})


def sky(calmap, rng, *, level_e=80.0, xy=(), flux_e=5000.0, exposure_s=EXPOSURE_S):
    """A vignetted sky with stars, as the camera of the map shows it."""
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    light = level_e / (1 + 0.25 * ((x - 240) ** 2 + (y - 180) ** 2) / 240**2) ** 2
    for cx, cy in xy:
        across, down = (np.diff(erf((np.arange(n + 1) - 0.5 - c) / (np.sqrt(2) * SIGMA))) / 2
                        for n, c in ((SHAPE[1], cx), (SHAPE[0], cy)))
        light = light + flux_e * np.outer(down, across)
    electrons = rng.poisson(light * calmap.response + calmap.dark_rate_dn_per_s * exposure_s / GAIN)
    data = np.rint(calmap.offset_dn + GAIN * electrons + rng.normal(0, READ_DN, SHAPE))
    return Frame(data=np.clip(data, 0, 4095).astype(np.uint16), bit_depth=12, white_level_dn=4095.0, exposure_s=exposure_s)


def places(rng, n=25):
    x, y = np.meshgrid(np.linspace(20, 460, 7), np.linspace(20, 340, 5))
    return np.stack([x.ravel(), y.ravel()], -1)[rng.permutation(35)[:n]] + rng.uniform(-0.5, 0.5, (n, 2))


def nearest(spots, xy):
    distance = np.linalg.norm(spots.xy_px[:, None] - xy[None], axis=-1)
    return distance.argmin(0), distance.min(0)


def test_the_spots_are_those_of_the_corrected_frame(calmap):
    rng = np.random.default_rng(2)
    xy = places(rng)
    frame = sky(calmap, rng, xy=xy)
    fast = find_stars(frame, calmap, FindState())
    slow = find_spots(correct(frame, calmap), calmap.psf, psf_known=True)
    row, distance = nearest(fast, xy)
    other, _ = nearest(slow, xy)
    assert distance.max() < 0.3
    sd = np.sqrt(np.einsum("nii->n", fast.covariance_px2[row]))
    assert (np.linalg.norm(fast.xy_px[row] - slow.xy_px[other], axis=1) < 0.5 * sd).all()
    np.testing.assert_allclose(fast.flux_e[row], slow.flux_e[other], rtol=0.02)


def test_centroids_are_honest_over_a_series(calmap):
    rng, state, squares, errors = np.random.default_rng(3), FindState(), [], []
    for _ in range(30):
        xy = places(rng)
        spots = find_stars(sky(calmap, rng, xy=xy), calmap, state)
        row, distance = nearest(spots, xy)
        clean = (spots.flags[row] == 0) & (distance < 0.5)
        assert clean.mean() > 0.8
        error = (spots.xy_px[row] - xy)[clean]
        inverse = np.linalg.inv(spots.covariance_px2[row][clean])
        squares += (np.einsum("ni,nij,nj->n", error, inverse, error) / 2).tolist()
        errors += error.tolist()
    assert np.mean(squares) == pytest.approx(1.0, abs=0.12)  # 700 spots: 3 sigma
    assert np.abs(np.mean(errors, axis=0)).max() < 0.003


def test_the_threshold_map_is_carried_while_it_holds_and_made_anew_when_not(calmap):
    rng, state = np.random.default_rng(4), FindState()
    for level in (80.0, 80.5, 81.0, 79.5):
        find_stars(sky(calmap, rng, level_e=level), calmap, state)
    assert state.made == 1
    find_stars(sky(calmap, rng, level_e=110.0), calmap, state)
    assert state.made == 2
    find_stars(sky(calmap, rng, level_e=110.0, exposure_s=0.2), calmap, state)
    assert state.made == 3


def test_false_alarms_are_those_asked_for_under_vignetting_and_hot_pixels(calmap):
    """240 are asked for over a series whose sky drifts by a sixth of its noise; their number's standard deviation is 6.5 %."""
    rng, state, count, frames = np.random.default_rng(5), FindState(false_alarms=6.0), 0, 40
    for n in range(frames):
        count += len(find_stars(sky(calmap, rng, level_e=80 + 1.5 * np.sin(n)), calmap, state))
    assert state.made < 4
    assert 0.8 < count / (6.0 * frames) < 1.2


def test_spots_say_what_is_wrong_with_them(calmap):
    rng = np.random.default_rng(6)
    xy = np.array([[100.2, 100.1], [105.1, 101.0], [250.0, 1.2], [400.3, 200.2]])
    frame = sky(calmap, rng, xy=xy, flux_e=np.float64(30000))
    data = frame.data.copy()
    data[199:202, 399:402] = 4095
    frame = Frame(data=data, bit_depth=12, white_level_dn=4095.0, exposure_s=EXPOSURE_S)
    spots = find_stars(frame, calmap, FindState(false_alarms=0.01))
    row, distance = nearest(spots, xy)
    assert distance.max() < 1
    for i, name in enumerate(("blend", "blend", "edge", "saturated")):
        assert spots.flags[row[i]] & SPOT_FLAGS[name], name
    assert spots.covariance_px2[row[3], 0, 0] > 4 * spots.covariance_px2[row[0], 0, 0]


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_other_kinds_of_data(dtype):
    rng = np.random.default_rng(7)
    calmap = CalibrationMap(image_size_px=SHAPE[::-1])
    xy = places(rng)
    y, x = np.mgrid[:SHAPE[0], :SHAPE[1]]
    image = rng.normal(20, 2, SHAPE) + sum(60 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 2) for cx, cy in xy)
    frame = Frame(data=np.clip(np.rint(image), 0, 255).astype(dtype), bit_depth=8, white_level_dn=255.0)
    spots = find_stars(frame, calmap, FindState())
    assert nearest(spots, xy)[1].max() < 0.4 and len(spots) < 30
