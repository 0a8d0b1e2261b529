"""Flats: response and illumination kept apart, gain with an honest error bar, and refusals that name the right exposure."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure import flat
from calibench.records import DEFECT_FLAGS, CalibrationMap, Frame

SHAPE = (240, 320)
GAIN_DN_PER_E, OFFSET_DN, READ_E, PRNU = 0.4, 60.0, 8.0, 0.01
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]]
VIGNETTE = 1 - 0.4 * (((X - 160) / 200) ** 2 + ((Y - 120) / 200) ** 2)


def frame(rng, light_e, response, *, kind="flat", exposure_s=0.1, white=4095):
    electrons = rng.poisson(light_e * VIGNETTE * response, SHAPE) + rng.normal(0, READ_E, SHAPE)
    data = np.clip(np.rint(OFFSET_DN + GAIN_DN_PER_E * electrons), 0, white).astype(np.uint16)
    return Frame(data=data, kind=kind, bit_depth=12, white_level_dn=white, exposure_s=exposure_s)


def session(rng, response, *, lights=(5000,), count=10, exposure_s=0.1):
    darks = [frame(rng, 0, response, kind="dark", exposure_s=exposure_s) for _ in range(count)]
    return darks + [frame(rng, light, response, exposure_s=exposure_s) for light in lights for _ in range(count)]


@pytest.fixture(scope="module")
def response():
    pattern = np.random.default_rng(0).normal(1, PRNU, SHAPE)
    pattern[50, 60], pattern[100, 200] = 0.05, 0.5
    return pattern


@pytest.fixture(scope="module")
def result(response):
    return flat.measure(session(np.random.default_rng(1), response))


def test_response_and_illumination_are_kept_apart(result, response):
    error = result.maps["response"] - response / response.mean()
    assert error.std() == pytest.approx(float(np.mean(result.maps["response_uncertainty"])), rel=0.1)
    np.testing.assert_allclose(result.maps["illumination"], VIGNETTE / VIGNETTE.max(), atol=2e-3)
    assert result.maps["response"].mean() == pytest.approx(1)


def test_dust_stays_in_the_response(response):
    dust = 1 - 0.1 * np.exp(-((X - 220) ** 2 + (Y - 80) ** 2) / (2 * 5.0**2))
    result = flat.measure(session(np.random.default_rng(2), response * dust))
    np.testing.assert_allclose(result.maps["illumination"], VIGNETTE / VIGNETTE.max(), atol=5e-3)
    assert result.maps["response"][77:84, 217:224].mean() == pytest.approx(0.92, abs=0.015)


def test_prnu_against_truth(result):
    for name in ("prnu_1288_percent", "prnu_core_percent"):
        figure = result.quantity(name)
        slack = 0.02 if name == "prnu_core_percent" else 0.12  # the two defects are in the standard figure
        assert abs(figure.value - 100 * PRNU) < 4 * figure.uncertainty + slack
    assert result.quantity("prnu_raw_percent").value > 5


def test_dead_and_cold_pixels(result):
    defects = result.maps["defects"]
    assert defects[50, 60] == DEFECT_FLAGS["dead"] and defects[100, 200] == DEFECT_FLAGS["cold"]
    assert np.count_nonzero(defects) == 2


def test_gain_of_one_level_and_of_a_ladder(response):
    for lights in ((5000,), (800, 2000, 4000, 6000)):
        figure = flat.measure(session(np.random.default_rng(3), response, lights=lights, count=6)).quantity("gain_dn_per_e")
        assert abs(figure.value - GAIN_DN_PER_E) < 4 * figure.uncertainty
        assert figure.uncertainty < 0.01 * GAIN_DN_PER_E


def test_gain_error_bar_matches_the_scatter(response):
    sessions = (session(np.random.default_rng(seed), response, count=2) for seed in range(20))
    figures = [flat.measure(frames).quantity("gain_dn_per_e") for frames in sessions]
    scatter = np.std([f.value for f in figures], ddof=1)
    assert 0.6 < scatter / np.mean([f.uncertainty for f in figures]) < 1.5


def test_flicker_is_said_and_does_not_enter_the_gain(response):
    rng = np.random.default_rng(4)
    frames = session(rng, response, lights=(), count=8) + [frame(rng, 5000 * (1 + 0.004 * i), response) for i in range(8)]
    result = flat.measure(frames)
    assert any("flickers" in w for w in result.warnings)
    assert result.quantity("gain_dn_per_e").value == pytest.approx(GAIN_DN_PER_E, rel=0.02)


def test_bayer_planes_have_their_own_level(response):
    rng = np.random.default_rng(5)
    colour = np.ones(SHAPE)
    colour[::2, 1::2] = colour[1::2, ::2] = 1.8
    frames = [Frame(data=f.data, kind=f.kind, bit_depth=12, white_level_dn=4095, exposure_s=0.1, bayer_pattern="RGGB")
              for f in session(rng, response * colour, lights=(3000,))]
    result = flat.measure(frames)
    for plane in (np.s_[::2, ::2], np.s_[::2, 1::2]):
        assert result.maps["response"][plane].mean() == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(result.maps["illumination"], VIGNETTE / VIGNETTE.max(), atol=4e-3)
    assert result.quantity("prnu_core_percent").value == pytest.approx(100 * PRNU, rel=0.1)


def test_the_dark_may_come_from_a_map(response):
    frames = [f for f in session(np.random.default_rng(6), response) if f.kind == "flat"]
    full = np.full(SHAPE, 1.0)
    calmap = CalibrationMap(image_size_px=SHAPE[::-1], measured=frozenset({"offset_dn", "read_noise_dn"}),
                            offset_dn=OFFSET_DN * full, read_noise_dn=np.sqrt((READ_E * GAIN_DN_PER_E) ** 2 + 1 / 12) * full)
    result = flat.measure(frames, None, calmap)
    assert result.quantity("gain_dn_per_e").value == pytest.approx(GAIN_DN_PER_E, rel=0.02)
    with pytest.raises(BadInput, match="flats need darks"):
        flat.measure(frames)


def test_saturated_and_dim_flats_name_the_right_exposure(response):
    rng = np.random.default_rng(7)
    with pytest.raises(BadInput, match=r"saturated at 0\.1 s; at most 0\.0\d+ s would be right"):
        flat.measure(session(rng, response, lights=(40000,), count=3))
    with pytest.raises(BadInput, match=r"too dim.* at 0\.1 s; [34]\.?\d* s would be right"):
        flat.measure(session(rng, response, lights=(150,), count=3))


def test_real_ccd(real):
    folder = real / "sensor" / "emva_ccd12_001"
    expected = json.loads((folder / "values_r4_rules.json").read_text())
    frames, kind, exposure_s = [], "", 0.0
    for line in (folder / "EMVA1288_Data.txt").read_text().splitlines():
        words = line.split()
        if words and words[0] in ("b", "d"):
            kind, exposure_s = {"b": "flat", "d": "dark"}[words[0]], float(words[1]) * 1e-9
        elif words and words[0] == "i":
            file = folder / words[1].replace("\\", "/")
            frames.append(Frame(data=cv2.imread(str(file), cv2.IMREAD_UNCHANGED), kind=kind, bit_depth=12, white_level_dn=4095,
                                exposure_s=exposure_s, file=file.name))
    result = flat.measure(frames)
    gain = result.quantity("gain_dn_per_e")
    assert abs(gain.value - expected["R4 sat"]["K_free_offset"]) < 2 * gain.uncertainty < 0.01
    prnu = result.quantity("prnu_1288_percent")
    assert abs(prnu.value - expected["R4 7x7*11x11*3x3"]["total"]["PRNU_pct"]) < 2 * prnu.uncertainty < 0.005
    raw = result.quantity("prnu_raw_percent")
    assert abs(raw.value - expected["no highpass (emva1288 1.0.2)"]["total"]["PRNU_pct"]) < 2 * raw.uncertainty
