"""The scan against a plain form of it, its growth against scipy's labels, and the false alarms that were asked for."""

import numpy as np
import pytest
from scipy import ndimage

from calibench.spots.background import background_and_noise
from calibench.spots.detect import kernels
from calibench.spots.detect.scan import candidates_on
from calibench.spots.false_alarms import NoiseLaw, k_for_false_alarms, step_from_skewness
from calibench.spots.room import Room
from calibench.spots.threshold_map import threshold_map


def noisy(rng, shape=(240, 320), level=100.0):
    return np.rint(rng.poisson(level, shape) + rng.normal(0, 3, shape)).astype(np.uint16)


def star(data, x, y, flux, rng, sigma=0.8):
    rows, columns = np.mgrid[:data.shape[0], :data.shape[1]]
    light = flux * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 2 / sigma**2) / (2 * np.pi * sigma**2)
    return data + rng.poisson(light).astype(data.dtype)


def plain_scan(data, thresholds, k):
    """Every pixel, in plain numpy: the peaks that the compiled scan must find, and their scores."""
    found = {}
    residual = data - thresholds.expected_dn.astype(float)
    excess = np.where(np.isfinite(residual), data.astype(float) - thresholds.seed_dn, -np.inf)
    weight = np.outer((kernels.SIDE, 1, kernels.SIDE), (kernels.SIDE, 1, kernels.SIDE))
    for y in range(1, data.shape[0] - 1):
        for x in range(1, data.shape[1] - 1):
            part = np.s_[y - 1:y + 2, x - 1:x + 2]
            near = excess[part].ravel()
            if near[4] <= 0 or (near > near[4]).any() or (near[:4] == near[4]).any():
                continue
            used = np.isfinite(residual[part])
            noise, light = thresholds.noise_dn[part][used].astype(float), residual[part][used]
            score = (weight[used] * light / noise**2).sum() / np.sqrt((weight[used] ** 2 / noise**2).sum())
            if score > k and residual[y, x] < kernels.SHARPEST * np.clip(light, 0, None).sum():
                found[y, x] = score
    return found


@pytest.mark.parametrize("masked", [False, True])
def test_the_scan_is_its_plain_form(masked):
    rng = np.random.default_rng(1)
    data = noisy(rng)
    for x, y, flux in rng.uniform((5, 5, 50), (315, 235, 3000), (40, 3)):
        data = star(data, x, y, flux, rng)
    expected = np.full(data.shape, 100.0)
    if masked:
        expected[rng.random(data.shape) < 0.02] = np.nan
    thresholds = threshold_map(expected, np.full(data.shape, np.sqrt(109.0)), np.uint16)
    room = Room(data.shape)
    count = kernels.scan(data, thresholds.seed_dn, thresholds.lowest_dn, thresholds.expected_dn,
                         thresholds.noise_dn, thresholds.coarse_dn, thresholds.no_drift, 4.0, room.above, room.eight,
                         room.waiting, room.peaks)
    rows, columns, scores = room.peaks[:count].T
    wanted = plain_scan(data, thresholds, 4.0)
    assert len(wanted) > 30
    assert set(zip(rows.tolist(), columns.tolist(), strict=True)) == set(wanted)
    there = zip(rows.tolist(), columns.tolist(), strict=True)
    np.testing.assert_allclose(scores, [wanted[place] for place in there], rtol=1e-6)


def test_a_spot_is_what_is_connected_to_its_peak():
    rng = np.random.default_rng(2)
    data = noisy(rng)
    places = [(60.2, 50.1, 4000), (200.7, 150.3, 20000), (120.0, 200.0, 900)]
    for place in places:
        data = star(data, *place, rng, sigma=1.2)
    thresholds = threshold_map(np.full(data.shape, 100.0), np.full(data.shape, np.sqrt(109.0)), np.uint16)
    found = candidates_on(data, thresholds, 5.5)
    labels, _ = ndimage.label(data - 100.0 > kernels.GROW_SIGMA * np.sqrt(109.0), structure=np.ones((3, 3)))
    assert len(found) == 3
    for place in places:
        row = np.linalg.norm(found.xy_px - place[:2], axis=1).argmin()
        x, y = found.peak_xy[row]
        mine = labels == labels[y, x]
        assert np.hypot(*(found.xy_px[row] - place[:2])) < 0.4
        assert found.pixels[row] == mine.sum()
        assert found.flux_dn[row] == pytest.approx((data[mine] - 100.0).sum(), rel=1e-6)
        assert not found.blend[row] and found.elongation[row] < 2


def test_two_stars_in_one_light_are_a_blend_and_the_wing_of_one_is_none():
    rng = np.random.default_rng(3)
    data = star(star(noisy(rng), 100.0, 100.0, 60000, rng, sigma=1.3), 105.5, 101.0, 20000, rng, sigma=1.3)
    data = star(data, 220.0, 120.0, 400000 // 8, rng, sigma=2.0)
    thresholds = threshold_map(np.full(data.shape, 100.0), np.full(data.shape, np.sqrt(109.0)), np.uint16)
    found = candidates_on(data, thresholds, 5.5, gain_dn_per_e=1.0)
    assert len(found) == 3
    assert sorted(np.hypot(*(found.xy_px - [102.7, 100.5]).T) < 5) == [False, True, True]
    np.testing.assert_array_equal(found.blend, np.hypot(*(found.xy_px - [102.7, 100.5]).T) < 5)


def test_a_trail_is_one_long_spot():
    rng = np.random.default_rng(4)
    data = noisy(rng)
    for step in np.linspace(0, 1, 60):
        data = star(data, 50 + 60 * step, 40 + 45 * step, 900, rng, sigma=1.0)
    thresholds = threshold_map(np.full(data.shape, 100.0), np.full(data.shape, np.sqrt(109.0)), np.uint16)
    found = candidates_on(data, thresholds, 5.5, gain_dn_per_e=1.0)
    assert len(found) == 1 and found.elongation[0] > 3


@pytest.mark.parametrize(("electrons", "read_e", "gain"), [(200, 4, 1.0), (10, 2, 1.0), (20, 3, 0.25)])
@pytest.mark.parametrize("known", [True, False])
def test_the_false_alarms_asked_for_are_those_obtained(electrons, read_e, gain, known):
    """Integer frames of skewed and coarse noise, level and noise from the frame itself, gain known or not; 240 are asked for,
    and the standard deviation of their number is 6.5 %."""
    rng = np.random.default_rng(5)
    asked, frames, count = 30.0, 8, 0
    for _ in range(frames):
        data = np.rint(gain * (rng.poisson(electrons, (640, 640)) + rng.normal(0, read_e, (640, 640))) + 60.3).astype(np.uint16)
        background, noise = background_and_noise(data)
        thresholds = threshold_map(background, noise, np.uint16)
        law = NoiseLaw(step_dn=gain, normal_dn=np.sqrt(gain**2 * read_e**2 + 1 / 12), whole_dn=True)
        if not known:
            law = NoiseLaw(step_dn=step_from_skewness(data - background, noise, np.zeros(data.shape, bool)), whole_dn=True)
        count += len(candidates_on(data, thresholds, k_for_false_alarms(thresholds, asked, law)))
    assert 0.8 < count / (asked * frames) < 1.2


def test_fewer_false_alarms_ask_for_a_higher_threshold():
    thresholds = threshold_map(np.zeros((1000, 1000)), np.ones((1000, 1000)), np.float32)
    found = [k_for_false_alarms(thresholds, asked, NoiseLaw()) for asked in (10.0, 1.0, 0.1)]
    assert 3 < found[0] < found[1] - 0.2 < found[2] - 0.4 < 6
