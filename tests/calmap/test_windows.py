"""Windows corrected by the map equal the corrected full frame."""

import numpy as np
import pytest

from calibench.calmap.correct import correct
from calibench.calmap.windows import WindowLayers
from calibench.errors import BadInput
from calibench.records import DEFECT_FLAGS, CalibrationMap, Frame

SHAPE = (60, 80)


def camera(rng, *layers):
    values = {"offset_dn": rng.normal(60, 3, SHAPE), "dark_rate_dn_per_s": rng.exponential(20, SHAPE),
              "response": rng.normal(1, 0.02, SHAPE), "read_noise_dn": rng.uniform(1, 3, SHAPE)}
    values = {name: value.astype(np.float32) for name, value in values.items() if name in layers}
    if "response" in values:
        values["response"][7, 9] = 0
    if "defects" in layers:
        values["defects"] = np.where(rng.random(SHAPE) < 0.02, DEFECT_FLAGS["hot"], 0).astype(np.uint16)
    if "gain_dn_per_e" in layers:
        values["gain_dn_per_e"] = 0.4
    if "linearity_dn" in layers:
        values["linearity_dn"] = np.array([[0, 0], [200, 210], [500, 540], [900, 1000]])
    if "saturation_dn" in layers:
        values["saturation_dn"] = 900.0
    return CalibrationMap(image_size_px=SHAPE[::-1], measured=frozenset(layers), **values)


@pytest.mark.parametrize("layers", [(), ("offset_dn", "dark_rate_dn_per_s"), ("response", "read_noise_dn"), (
    "offset_dn", "dark_rate_dn_per_s", "response", "read_noise_dn", "defects", "linearity_dn", "saturation_dn")])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_windows_equal_the_corrected_frame(layers, dtype):
    rng = np.random.default_rng(1)
    calmap = camera(rng, *layers)
    frame = Frame(data=rng.integers(40, 1000, SHAPE).astype(dtype), bit_depth=10, white_level_dn=1000.0, exposure_s=0.2)
    whole = correct(frame, calmap)
    centre = np.array([[10, 10], [79, 30], [40, 0], [0, 59], [9, 7], [55, 44]])
    found = WindowLayers.of(frame, calmap).windows(frame.data, centre, 3)
    for n, (x0, y0) in enumerate(found.corner_xy):
        assert (x0, y0) == tuple(centre[n] - 3)
        for j in range(7):
            for i in range(7):
                x, y = x0 + i, y0 + j
                if 0 <= x < SHAPE[1] and 0 <= y < SHAPE[0]:
                    assert found.signal_dn[n, j, i] == pytest.approx(whole.signal_dn[y, x], rel=1e-6, abs=1e-6)
                    assert found.defects[n, j, i] == whole.defects[y, x]
                else:
                    assert np.isnan(found.signal_dn[n, j, i])


def test_a_frame_of_another_size_is_refused():
    frame = Frame(data=np.zeros((10, 10), np.uint16), bit_depth=10, white_level_dn=1023.0)
    with pytest.raises(BadInput, match="80 x 60"):
        WindowLayers.of(frame, camera(np.random.default_rng(2)))
