"""Dark rate and hot pixels of a map in a frame of another exposure and temperature."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.calmap.correct import correct
from calibench.calmap.dark_signal import without_harmless
from calibench.calmap.thermal import warming
from calibench.records import DEFECT_FLAGS, CalibrationMap, Conditions, Frame

W, H = 6, 4
HOT, WARM, NOISY = (DEFECT_FLAGS[name] for name in ("hot", "warm", "noisy"))


def camera_map(**changes) -> CalibrationMap:
    layers = {"offset_dn": np.full((H, W), 60.0), "dark_rate_dn_per_s": np.full((H, W), 40.0), "dark_reference_c": 20.0,
              "read_noise_dn": np.full((H, W), 2.0), "gain_dn_per_e": 0.1,
              "dark_rate_uncertainty_dn_per_s": np.full((H, W), 0.1)} | changes
    return CalibrationMap(image_size_px=(W, H), measured=frozenset(layers), **layers,
                          conditions=Conditions(temperature_c=(0.0, 30.0), exposure_s=(0.01, 5.0)))


def frame(celsius, exposure_s=2.0) -> Frame:
    return Frame(data=np.full((H, W), 200, np.uint16), bit_depth=12, white_level_dn=4095.0, exposure_s=exposure_s,
                 temperature_c=celsius)


def test_the_dark_rate_follows_the_temperature():
    calmap = camera_map(dark_activation_ev=0.6)
    corrected = correct(frame(10.0), calmap)
    np.testing.assert_allclose(corrected.signal_dn, 140 - 80 * warming(10.0, 20.0, 0.6), rtol=1e-5)
    assert not any("scaled" in w for w in corrected.warnings)


@pytest.mark.parametrize(("celsius", "said"), [(10.0, True), (20.3, False)])
def test_without_a_law_a_difference_of_temperature_is_said(celsius, said):
    corrected = correct(frame(celsius), camera_map())
    np.testing.assert_allclose(corrected.signal_dn, 60.0)
    assert any("not scaled" in w for w in corrected.warnings) == said


def test_a_hot_pixel_counts_by_its_charge_in_the_frame():
    defects = np.zeros((H, W), np.uint16)
    defects[0, 0], defects[0, 1], defects[0, 2] = HOT, HOT | NOISY, HOT
    rate = np.full((H, W), 1.0)
    rate[0, :3] = 400.0, 400.0, 4000.0
    calmap = camera_map(defects=defects, dark_rate_dn_per_s=rate)
    # Variance of the dark charge: 0.1 * 400 * t, of the reading 4: equal at 0.1 s
    short, long = (without_harmless(calmap, t) for t in (0.09, 0.11))
    assert list(short[0, :3]) == [WARM, WARM | NOISY, HOT]
    np.testing.assert_array_equal(long, defects)
    assert correct(frame(20.0, 0.09), calmap).defects[0, 0] == WARM


def test_a_dark_rate_that_is_poorly_known_stays_a_defect():
    defects = np.full((H, W), HOT, np.uint16)
    uncertain = camera_map(defects=defects, dark_rate_uncertainty_dn_per_s=np.full((H, W), 30.0))
    assert (without_harmless(uncertain, 0.09) == HOT).all()
    assert (without_harmless(camera_map(defects=defects), 0.09) == WARM).all()
    blind = camera_map(defects=defects)
    blind = CalibrationMap(image_size_px=(W, H), measured=blind.measured - {"gain_dn_per_e"}, defects=defects,
                           dark_rate_dn_per_s=blind.dark_rate_dn_per_s, read_noise_dn=blind.read_noise_dn)
    assert (without_harmless(blind, 0.09) == HOT).all()
