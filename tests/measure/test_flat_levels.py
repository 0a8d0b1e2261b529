from __future__ import annotations

import numpy as np

from calibench.measure._flat.levels import FlatLevels
from calibench.records import Frame

SHAPE = (16, 20)


def test_a_ladder_keeps_images_of_the_best_and_the_brightest_level_alone():
    rng, flats = np.random.default_rng(0), FlatLevels(saturated=0.01)
    fills = np.linspace(0.05, 1.1, 22)
    for i, fill in enumerate(fills):
        for _ in range(3 if i == 8 else 2):
            data = np.rint(rng.normal(4095 * fill, 5, SHAPE)).clip(0, 4095).astype(np.uint16)
            frame = Frame(data=data, bit_depth=12, white_level_dn=4095.0, kind="flat", exposure_s=0.01 * (i + 1))
            flats.add(frame, float(data.mean()))
    assert flats.close() is None
    assert [v.count for v in flats.levels] == [3 if i == 8 else 2 for i in range(22)]
    held = [v for v in flats.levels if v.mean_image_dn is not None]
    assert len(held) == 2
    assert {v.count for v in held} == {2, 3}
    assert max(v.typical_dn for v in flats.levels if v.saturated < 0.01) == max(v.typical_dn for v in held)
    for one in flats.levels:
        assert abs(one.level_dn - min(4095 * fills[round(100 * one.exposure_s) - 1], 4095)) < 4
