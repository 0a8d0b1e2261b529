"""The map on a frame: against a frame made by hand from the camera model, and on what is missing or too much."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.calmap.correct import correct, interpolate_defects
from calibench.errors import BadInput
from calibench.records import DEFECT_FLAGS, CalibrationMap, Frame

W, H = 40, 30


def camera_map(**changes) -> CalibrationMap:
    rng = np.random.default_rng(5)
    layers = {"offset_dn": rng.uniform(60, 70, (H, W)), "dark_rate_dn_per_s": rng.uniform(0, 9, (H, W)),
              "response": rng.uniform(0.9, 1.1, (H, W)), "read_noise_dn": np.full((H, W), 2.0),
              "gain_dn_per_e": 0.1} | changes
    return CalibrationMap(image_size_px=(W, H), measured=frozenset(layers), **layers)


def frame_of(data, **changes) -> Frame:
    return Frame(**{"data": data, "bit_depth": 12, "white_level_dn": 4095.0, "exposure_s": 0.5} | changes)


def test_the_light_comes_back_from_under_offset_dark_and_response():
    calmap = camera_map()
    light = np.random.default_rng(6).uniform(0, 500, (H, W))
    data = calmap.offset_dn + 0.5 * calmap.dark_rate_dn_per_s + calmap.response * light
    corrected = correct(frame_of(data.astype(np.float32)), calmap)
    np.testing.assert_allclose(corrected.signal_dn, light, atol=1e-3)
    assert corrected.signal_dn.dtype == corrected.variance_dn2.dtype == np.float32
    assert corrected.defects.dtype == np.uint16 and not corrected.defects.any()


def test_the_variance_is_the_scatter_of_simulated_frames():
    response = np.where(np.arange(W) < W // 2, 0.5, 1.5) * np.ones((H, 1))
    calmap = camera_map(response=response)
    rng = np.random.default_rng(8)
    light_e = 800.0
    signals, variances = [], []
    for _ in range(300):
        electrons = rng.poisson((light_e * calmap.response + 0.5 * calmap.dark_rate_dn_per_s / 0.1).astype(float))
        # The scatter that a raw frame shows holds the quantisation; here it is left to the rounding itself.
        noise = rng.normal(0, np.sqrt(2.0**2 - 1 / 12), (H, W))
        data = np.round(calmap.offset_dn + 0.1 * electrons + noise).astype(np.uint16)
        corrected = correct(frame_of(data), calmap)
        signals.append(corrected.signal_dn)
        variances.append(corrected.variance_dn2)
    assert np.mean(signals) == pytest.approx(light_e * 0.1, rel=2e-3)
    seen, said = np.var(signals, axis=0, ddof=1), np.mean(variances, axis=0)
    for half in (response < 1, response > 1):
        assert said[half].mean() == pytest.approx(seen[half].mean(), rel=0.02)


def test_without_a_gain_the_variance_is_the_read_noise_of_the_dark_sky():
    calmap = CalibrationMap(image_size_px=(W, H), measured=frozenset(["read_noise_dn"]),
                            read_noise_dn=np.full((H, W), 2.0))
    corrected = correct(frame_of(np.full((H, W), 500, np.uint16)), calmap)
    np.testing.assert_array_equal(corrected.variance_dn2, 4.0)


def test_without_a_read_noise_the_variance_is_unknown_everywhere():
    calmap = CalibrationMap(image_size_px=(W, H), measured=frozenset(["gain_dn_per_e"]), gain_dn_per_e=0.1)
    corrected = correct(frame_of(np.full((H, W), 500, np.uint16)), calmap)
    assert np.isnan(corrected.variance_dn2).all() and np.all(corrected.signal_dn == 500)


def test_quantisation_is_the_floor_of_the_read_noise():
    calmap = camera_map(read_noise_dn=np.zeros((H, W)), response=np.ones((H, W)))
    corrected = correct(frame_of(np.zeros((H, W), np.uint16)), calmap)
    np.testing.assert_allclose(corrected.variance_dn2, 1 / 12, rtol=1e-6)


def test_an_empty_map_changes_nothing():
    data = np.random.default_rng(1).integers(0, 4000, (H, W)).astype(np.uint16)
    corrected = correct(frame_of(data), CalibrationMap(image_size_px=(W, H)))
    np.testing.assert_array_equal(corrected.signal_dn, data)


@pytest.mark.parametrize(("white_level_dn", "saturation_dn", "first"), [(4095, np.inf, 4095), (4095, 3900.0, 3900)])
def test_saturated_pixels_are_flagged_beside_the_map_s_own(white_level_dn, saturation_dn, first):
    data = np.full((H, W), 100, np.uint16)
    data[0, :3] = first - 1, first, 4095
    defects = np.zeros((H, W), np.uint16)
    defects[0, 2] = DEFECT_FLAGS["stuck"]
    calmap = camera_map(saturation_dn=saturation_dn, defects=defects)
    found = correct(frame_of(data, white_level_dn=white_level_dn), calmap).defects
    saturated = DEFECT_FLAGS["saturated"]
    assert list(found[0, :4]) == [0, saturated, saturated | DEFECT_FLAGS["stuck"], 0] and np.count_nonzero(found) == 2


def test_a_response_of_zero_gives_a_dead_pixel_and_no_infinity():
    response = np.ones((H, W))
    response[3, 4], response[3, 5] = 0.0, -0.1
    corrected = correct(frame_of(np.full((H, W), 100, np.uint16)), camera_map(response=response))
    assert np.isfinite(corrected.signal_dn).all() and np.isfinite(corrected.variance_dn2).all()
    assert np.argwhere(corrected.defects & DEFECT_FLAGS["dead"]).tolist() == [[3, 4], [3, 5]]


def test_a_frame_without_exposure_keeps_its_dark_charge_and_says_so():
    calmap = camera_map(response=np.ones((H, W)))
    corrected = correct(frame_of(np.full((H, W), 100, np.uint16), exposure_s=None), calmap)
    np.testing.assert_allclose(corrected.signal_dn, 100 - calmap.offset_dn, rtol=1e-5)
    assert any("no exposure" in w for w in corrected.warnings)
    assert not any("no exposure" in w for w in correct(frame_of(np.full((H, W), 100, np.uint16)), calmap).warnings)


def test_a_frame_of_another_size_is_refused():
    with pytest.raises(BadInput, match="30 x 40 pixels, the map 40 x 30"):
        correct(frame_of(np.zeros((W, H), np.uint16)), camera_map())


def test_a_defect_becomes_the_mean_of_its_good_neighbours():
    signal = np.arange(25.0, dtype=np.float32).reshape(5, 5)
    defects = np.zeros((5, 5), np.uint16)
    defects[0, 0] = defects[2, 2] = DEFECT_FLAGS["hot"]
    defects[4, 4] = DEFECT_FLAGS["warm"]  # information, no reason to replace
    defects[1, 1] = DEFECT_FLAGS["dead"]
    filled = interpolate_defects(signal, defects)
    assert filled[0, 0] == pytest.approx((1 + 5) / 2)
    assert filled[2, 2] == pytest.approx((7 + 8 + 11 + 13 + 16 + 17 + 18) / 7)
    assert filled[4, 4] == 24 and filled.dtype == np.float32 and signal[0, 0] == 0
    untouched = (defects & ~np.uint16(DEFECT_FLAGS["warm"])) == 0
    np.testing.assert_array_equal(filled[untouched], signal[untouched])


def test_a_cluster_is_filled_from_its_rim():
    signal = np.full((9, 9), 7.0)
    defects = np.zeros((9, 9), np.uint16)
    signal[2:7, 2:7], defects[2:7, 2:7] = np.nan, DEFECT_FLAGS["dead"]
    np.testing.assert_allclose(interpolate_defects(signal, defects), 7.0)


def test_a_frame_of_defects_only_is_refused():
    with pytest.raises(BadInput, match="every pixel"):
        interpolate_defects(np.zeros((3, 3)), np.full((3, 3), DEFECT_FLAGS["dead"], np.uint16))
