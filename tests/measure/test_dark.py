"""Dark ladder: truth recovered, hot pixels found and few invented, and what is said where knowledge is missing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure import dark
from calibench.records import DEFECT_FLAGS, CalibrationMap, Conditions, Frame

GAIN_DN_PER_E, OFFSET_DN, READ_E, RATE_E_PER_S, DSNU_E = 0.5, 100.0, 6.0, 10.0, 4.0
SHAPE = (240, 320)


def darks(rng, exposures=(0.1, 0.5, 1.0, 2.0), count=8, hot=None, fixed=None, drift_dn=0.0, white=4095, bit_depth=12, **said):
    """Frames of a sensor with a fixed offset pattern; `hot` (H, W) e-/s is added to the mean rate."""
    fixed = rng.normal(0, DSNU_E, SHAPE) if fixed is None else fixed
    rate = RATE_E_PER_S + (0 if hot is None else hot)
    out = []
    for t in exposures:
        for i in range(count):
            electrons = fixed + rng.poisson(rate * t, SHAPE) + rng.normal(0, READ_E, SHAPE)
            data = np.clip(np.rint(OFFSET_DN + drift_dn * i + GAIN_DN_PER_E * electrons), 0, white).astype(np.uint16)
            out.append(Frame(data=data, kind="dark", bit_depth=bit_depth, white_level_dn=white, exposure_s=t,
                             file=f"dark_{t:g}_{i}.png", **said))
    return out


def count(result, name):
    return int(((result.maps["defects"] & DEFECT_FLAGS[name]) > 0).sum())


def test_truth_is_recovered_with_its_error_bars():
    result = dark.measure(darks(np.random.default_rng(0), egain_e_per_dn=1 / GAIN_DN_PER_E))
    with_shot_noise = np.sqrt(READ_E**2 + 0.1 * RATE_E_PER_S)
    for name, truth, slack in (("read_noise_e", with_shot_noise, 0.01), ("dark_current_e_per_s", RATE_E_PER_S, 0.0),
                               ("dsnu_raw_e", DSNU_E, 0.02), ("dsnu_1288_e", DSNU_E * 0.98850**0.5, 0.02),
                               ("dsnu_core_e", DSNU_E * 0.98850**0.5, 0.03), ("offset_dn", OFFSET_DN, 0.02)):
        figure = result.quantity(name)
        assert abs(figure.value - truth) < 4 * figure.uncertainty + slack, figure
        assert 0 < figure.uncertainty < 0.1 * truth
    assert result.maps["dark_rate_dn_per_s"].mean() == pytest.approx(RATE_E_PER_S * GAIN_DN_PER_E, rel=0.02)


def test_pixel_errors_match_the_scatter():
    rng = np.random.default_rng(1)
    fixed = np.zeros(SHAPE)
    a, b = (dark.measure(darks(rng, fixed=fixed)) for _ in range(2))
    for value, error in (("offset_dn", "offset_uncertainty_dn"), ("dark_rate_dn_per_s", "dark_rate_uncertainty_dn_per_s")):
        pull = (a.maps[value] - b.maps[value]) / np.hypot(a.maps[error], b.maps[error])
        assert np.std(pull) == pytest.approx(1, abs=0.06)


def test_hot_pixels_are_found_and_few_are_invented():
    rng = np.random.default_rng(2)
    where = rng.random(SHAPE) < 0.02  # so many that mean + 5 sigma blinds itself
    hot = np.where(where, rng.uniform(40, 400, SHAPE), 0)
    result = dark.measure(darks(rng, hot=hot, egain_e_per_dn=1 / GAIN_DN_PER_E))
    flag = (result.maps["defects"] & DEFECT_FLAGS["hot"]) > 0
    assert (flag & where).sum() >= 0.99 * where.sum()
    assert (flag & ~where).sum() == 0
    assert count(result, "warm") <= 3
    assert count(result, "hot_thesis") < 0.8 * where.sum()


def test_a_glow_is_not_a_defect():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    glow = 60 * np.exp(-(x**2 + y**2) / (2 * 80.0**2))
    result = dark.measure(darks(rng, hot=glow, egain_e_per_dn=1 / GAIN_DN_PER_E))
    assert count(result, "hot") + count(result, "warm") <= 5


def test_stuck_and_noisy_pixels_get_their_class():
    rng = np.random.default_rng(4)
    frames = darks(rng)
    changed = []
    for frame in frames:
        data = frame.data.copy()
        data[10, 10], data[20, 20] = 4095, 0
        data[30, 30] = np.clip(100 + rng.normal(0, 40), 0, 4095)
        changed.append(Frame(data=data, kind="dark", bit_depth=12, white_level_dn=4095, exposure_s=frame.exposure_s))
    defects = dark.measure(changed).maps["defects"]
    assert defects[10, 10] & DEFECT_FLAGS["stuck"] and defects[20, 20] & DEFECT_FLAGS["stuck"]
    assert defects[30, 30] & DEFECT_FLAGS["noisy"]
    assert ((defects & DEFECT_FLAGS["stuck"]) > 0).sum() == 2
    assert ((defects & DEFECT_FLAGS["noisy"]) > 0).sum() <= 3


def test_thesis_counts_grow_with_exposure():
    rng = np.random.default_rng(5)
    hot = np.where(rng.random(SHAPE) < 3e-3, rng.exponential(60, SHAPE), 0)
    result = dark.measure(darks(rng, exposures=(0.1, 0.5, 2.0), hot=hot))
    counts = result.evidence["hot_thesis_count"]
    assert counts[0] < counts[1] < counts[2]


def test_without_gain_the_e_figures_say_why():
    result = dark.measure(darks(np.random.default_rng(6)))
    assert result.quantity("read_noise_dn").value == pytest.approx(READ_E * GAIN_DN_PER_E, rel=0.02)
    assert result.quantity("read_noise_e").value is None and "gain unknown" in result.quantity("read_noise_e").reason


def test_gain_of_a_map_counts_only_at_its_gain_setting():
    frames = darks(np.random.default_rng(10), count=3, gain_setting=4.0)
    def calmap(setting):
        return CalibrationMap(image_size_px=SHAPE[::-1], measured=frozenset({"gain_dn_per_e"}), gain_dn_per_e=GAIN_DN_PER_E,
                              conditions=Conditions(gain_setting=setting))
    assert dark.measure(frames, None, calmap(4.0)).quantity("read_noise_e").value == pytest.approx(READ_E, rel=0.03)
    with pytest.raises(BadInput, match="gain setting 4"):
        dark.measure(frames, None, calmap(1.0))


def test_without_exposure_offset_and_defects_are_still_made():
    rng = np.random.default_rng(7)
    where = rng.random(SHAPE) < 1e-3
    frames = [Frame(data=f.data, bit_depth=12, white_level_dn=4095)
              for f in darks(rng, exposures=(2.0,), count=12, hot=np.where(where, 600.0, 0.0), drift_dn=3.0)]
    result = dark.measure(frames)
    assert "dark_rate_dn_per_s" not in result.maps
    assert result.quantity("dark_current_e_per_s").reason == "exposure unknown"
    assert any("exposure unknown" in w for w in result.warnings) and any("drifts" in w for w in result.warnings)
    flag = (result.maps["defects"] & DEFECT_FLAGS["hot"]) > 0
    np.testing.assert_array_equal(flag, where)
    noisy = (result.maps["defects"] & DEFECT_FLAGS["noisy"]) > 0
    assert (noisy & ~where).sum() <= 4  # drift is no noise of the pixels
    assert result.quantity("read_noise_dn").value == pytest.approx(GAIN_DN_PER_E * np.hypot(READ_E, 20**0.5), rel=0.03)


def test_a_time_unit_that_is_wrong_is_an_error_not_a_number():
    frames = darks(np.random.default_rng(8), exposures=(1e-9, 2e-9, 4e-9), hot=np.full(SHAPE, 2e9))
    with pytest.raises(BadInput, match="absurd"):
        dark.measure(frames)


def test_duplicates_are_counted_once():
    frames = darks(np.random.default_rng(9), exposures=(1.0,), count=4)
    copy = Frame(data=frames[0].data, kind="dark", bit_depth=12, white_level_dn=4095, exposure_s=1.0, file="copy.png")
    result = dark.measure([*frames, copy])
    assert result.frames_used == 4 and "dark_1_0.png" in dict(result.frames_rejected)["copy.png"]


def test_real_darks_of_a_warming_camera(real):
    files = sorted((real / "stars" / "creusot_dark").glob("dark_frame_test*.png"))
    frames = [Frame(data=cv2.imread(str(f), cv2.IMREAD_UNCHANGED), bit_depth=8, white_level_dn=255, file=f.name) for f in files]
    result = dark.measure(frames)
    last = frames[files.index(next(f for f in files if f.name.endswith("__195.png")))].data
    bright = last > np.median(last) + 40
    flag = (result.maps["defects"] & DEFECT_FLAGS["hot"]) > 0
    assert (flag & bright).sum() > 0.97 * bright.sum()
    assert flag.mean() < 0.005
    assert len(result.warnings) == 3 and result.frames_used == 14
