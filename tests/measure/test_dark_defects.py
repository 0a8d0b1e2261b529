"""Classes of the dark's defects: the null of the normal pixels, unsteady pixels, lines, bent pixels, temperatures."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.calmap.thermal import warming
from calibench.measure import dark
from calibench.measure._dark.levels import DarkLevels
from calibench.measure._dark.null import fit_null
from calibench.measure._dark.telegraph import confirmed, two_levels
from calibench.measure._defects import defective_lines
from calibench.records import DEFECT_FLAGS, Frame

GAIN_DN_PER_E, OFFSET_DN, READ_E, RATE_E_PER_S = 0.5, 100.0, 4.0, 5.0
SHAPE = (192, 256)


def darks(rate, exposures=(0.1, 1.0, 5.0), count=8, seed=1, lift_e=lambda t, i: 0.0, celsius=None):
    rng = np.random.default_rng(seed)
    frames = []
    for t in exposures:
        for i in range(count):
            charge = rng.poisson(rate * t) + rng.normal(0, READ_E, rate.shape) + lift_e(t, i)
            data = np.clip(np.rint(OFFSET_DN + GAIN_DN_PER_E * charge), 0, 4095).astype(np.uint16)
            frames.append(Frame(data=data, kind="dark", bit_depth=12, white_level_dn=4095, exposure_s=t, temperature_c=celsius,
                                egain_e_per_dn=1 / GAIN_DN_PER_E, file=f"{celsius}C/{t:g}s/{i}.png"))
    return frames


def normal_rate(seed=2, shape=SHAPE):
    return RATE_E_PER_S * np.exp(0.15 * np.random.default_rng(seed).standard_normal(shape))


def flagged(result, *names):
    return (result.maps["defects"] & sum(DEFECT_FLAGS[name] for name in names)) > 0


@pytest.mark.parametrize("spread", [0.0, 0.15])
@pytest.mark.parametrize("hot", [0.0, 0.03])
def test_the_null_of_normal_pixels_holds_beside_hot_ones(spread, hot):
    rng = np.random.default_rng(3)
    normal = np.exp(spread * rng.standard_normal(2_000_000)) + 0.02 * rng.standard_normal(2_000_000)
    sd = normal.std()
    z = (normal - np.median(normal)) / sd
    z[rng.random(z.size) < hot] += rng.exponential(80)
    false = np.count_nonzero(((normal - np.median(normal)) / sd) > fit_null(z).threshold(z.size, 20))
    assert 8 <= false <= 40  # 20 expected; a Gaussian would let 170 pass at a spread of 15 %


def test_recall_and_detection_limit_under_a_glow():
    rng = np.random.default_rng(4)
    shape = (320, 448)
    base = normal_rate(shape=shape) + np.linspace(0, 2, shape[1])
    excess = np.where(rng.random(shape) < 0.02, rng.exponential(40, shape), 0)
    result = dark.measure(darks(base + excess, count=6))
    found, limit = flagged(result, "hot", "warm"), result.quantity("hot_detection_limit_e_per_s")
    assert found[excess > limit.value].mean() > 0.985  # of some 3000
    assert found[(excess > 0) & (excess < 0.4 * limit.value)].mean() < 0.1
    assert np.count_nonzero(found & (excess == 0)) <= 2
    assert 5 < limit.value < 20 and not any("found reliably" in w for w in result.warnings)


def test_where_hot_pixels_cannot_be_seen_this_is_said():
    result = dark.measure(darks(normal_rate(), exposures=(0.01, 0.05, 0.1)))
    limit = result.quantity("hot_detection_limit_e_per_s")
    assert limit.value > 60 and any(f"only from {limit.value:.3g} e-/s" in w for w in result.warnings)


def test_telegraph_pixels_and_hits_are_told_from_hot_ones():
    rng = np.random.default_rng(5)
    jumping, hit, hot = (50, 60), (70, 80), (90, 100)
    up = rng.random(40) < 0.4

    def lift_e(t, i):
        image = np.zeros(SHAPE)
        image[jumping] = 40 * up[i]
        image[hit] = 3000 * (i == 7 and t == 5.0)
        return image

    rate = normal_rate()
    rate[hot] += 100
    result = dark.measure(darks(rate, exposures=(0.1, 1.0, 5.0), count=40, lift_e=lift_e))
    telegraph = flagged(result, "telegraph")
    assert telegraph[jumping] and np.count_nonzero(telegraph) == 1
    np.testing.assert_array_equal(result.evidence["telegraph_xy_px"], [jumping[::-1]])
    assert result.evidence["telegraph_step_dn"][0] == pytest.approx(40 * GAIN_DN_PER_E, rel=0.1)
    assert flagged(result, "noisy")[hit] and not flagged(result, "hot", "warm")[hit]
    assert flagged(result, "hot")[hot] and not flagged(result, "noisy", "telegraph")[hot]


def test_frames_that_stream_once_are_measured_without_the_second_look():
    where = np.random.default_rng(8).random(SHAPE) < 1e-3
    result = dark.measure(iter(darks(normal_rate(), exposures=(0.1, 1.0), count=4, lift_e=lambda t, i: 300 * (i == 1) * where)))
    assert any("second time" in w for w in result.warnings)


def test_noise_of_one_level_is_no_telegraph_signal():
    rng = np.random.default_rng(6)
    found, _, _ = two_levels(rng.normal(0, 3, (100, 20_000)).astype(np.float32))
    assert found.mean() < 3e-4
    step = two_levels((rng.normal(0, 3, 100) + 1000 * (np.arange(100) > 50))[:, None].astype(np.float32))
    assert not step[0][0]  # one jump is a drift, no telegraph


def test_most_frames_have_to_confirm_a_pixel():
    rng = np.random.default_rng(7)
    steady, hit = rng.normal(2.0, 1, (20, 5000)), rng.normal(0, 1, (20, 5000))
    hit[3] += 60
    assert confirmed(steady, np.zeros(5000), 1.0).mean() > 0.97
    assert confirmed(hit, np.zeros(5000), 1.0).mean() < 0.01


def test_a_pixel_that_bends_and_a_hot_column_get_their_flags():
    bent, column = (40, 50), 99

    def lift_e(t, i):
        image = np.zeros(SHAPE)
        image[bent] = -0.4 * 60 * t if t == 5.0 else 0.0
        return image

    rate = normal_rate()
    rate[bent] += 60
    rate[:, column] += 40
    result = dark.measure(darks(rate, lift_e=lift_e))
    assert flagged(result, "nonlinear")[bent] and np.count_nonzero(flagged(result, "nonlinear")) <= 2
    assert flagged(result, "column")[:, column].all() and np.count_nonzero(flagged(result, "column")) == SHAPE[0]
    assert not flagged(result, "row").any()


def test_lines_are_long_runs_and_no_areas():
    defective = np.zeros((200, 300), bool)
    defective[20:60, 50] = True
    defective[100, 10:18] = True
    defective[120:190, 200:280] = True
    rows, columns = defective_lines(defective)
    assert columns[20:60, 50].all() and not columns[:, 51].any() and not columns[100:, 50].any()
    assert not rows[100].any() and not rows[150, 240] and not columns[150, 240]


def test_the_activation_energy_is_found_with_its_error():
    energy_ev = 0.62
    frames = []
    for k, celsius in enumerate((0.0, 10.0, 20.0)):
        rate = 20 * float(warming(celsius, 20.0, energy_ev)) * np.ones(SHAPE)
        exposures = (0.1, 1.0, 4.0) if celsius == 20.0 else (0.1, 4.0)
        frames += darks(rate, exposures=exposures, count=4, seed=k, celsius=celsius)
    result = dark.measure(frames)
    found, doubling = result.quantity("dark_activation_ev"), result.quantity("dark_doubling_c")
    assert abs(found.value - energy_ev) < 4 * found.uncertainty and 0 < found.uncertainty < 0.02
    assert doubling.value == pytest.approx(np.log(2) * 8.617333e-5 * 293.15**2 / energy_ev, rel=0.02)
    assert result.layers == {"dark_reference_c": 20.0, "dark_activation_ev": found.value}
    assert result.provenance.conditions["temperature_c"] == (0.0, 20.0)
    assert np.median(result.maps["dark_rate_dn_per_s"]) == pytest.approx(20 * GAIN_DN_PER_E, rel=0.02)
    assert len(result.evidence["count_temperature_c"]) == 7 and not any("drifted" in w for w in result.warnings)


def test_without_a_law_the_map_holds_at_its_own_temperature():
    frames = darks(normal_rate(), celsius=20.0, count=3) + darks(normal_rate(), exposures=(1.0,), count=3, seed=9, celsius=5.0)
    result = dark.measure(frames)
    assert result.quantity("dark_activation_ev").value is None and result.layers == {"dark_reference_c": 20.0}
    assert result.provenance.conditions["temperature_c"] == (20.0, 20.0)
    assert any("without a law" in w for w in result.warnings)


def test_a_drift_that_returns_is_no_second_temperature():
    frames = [f for i in range(4) for f in darks(normal_rate(), count=1, seed=i, celsius=20 + 0.6 * i)]
    frames.sort(key=lambda f: f.exposure_s)
    result = dark.measure(frames)
    assert result.frames_used == 12 and list(result.evidence["frame_count"]) == [4, 4, 4]
    assert any("temperature drifted from 20.0 to 21.8 C" in w for w in result.warnings)


def test_levels_that_are_closed_and_opened_again_are_merged_exactly():
    frames = [f for pair in zip(*(darks(normal_rate(), exposures=(t,), count=6) for t in (0.1, 0.5, 1.0)), strict=True)
              for f in pair]
    whole, split = DarkLevels(), DarkLevels(most_bytes=1)
    for frame in frames:
        whole.add(frame)
    for frame in frames:
        split.add(frame)
    for a, b in zip(whole.groups()[0][0], split.groups()[0][0], strict=True):
        np.testing.assert_allclose(a.mean_dn, b.mean_dn, rtol=1e-6)
        assert a.count == b.count == 6 and b.freedom == 5
        np.testing.assert_allclose(b.variance_dn2.mean(), a.variance_dn2.mean(), rtol=0.02)
