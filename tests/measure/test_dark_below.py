from __future__ import annotations

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure._dark import below as module
from calibench.measure._dark.below import DarkBelow
from calibench.measure._dark.levels import DarkLevel

SHAPE = (20, 30)


def level(exposure_s, count, seed=0, offset=100.0, rate=2.0):
    rng = np.random.default_rng(seed)
    mean = (offset + rate * (exposure_s or 0.0) + rng.normal(0, 0.1, SHAPE)).astype(np.float32)
    return DarkLevel(exposure_s=exposure_s, group=0, celsius=(), mean_dn=mean, freedom=count - 1,
                     variance_dn2=np.full(SHAPE, 4.0, np.float32), constant=np.packbits(np.zeros(SHAPE, bool)),
                     levels_dn=np.full(count, float(mean.mean())))


def test_the_line_is_that_of_least_squares_with_each_frame_counted(monkeypatch):
    monkeypatch.setattr(module, "KEPT_BYTES", 0)  # one image is kept
    levels = [level(t, n, seed=n) for t, n in ((0.1, 9), (1.0, 3), (2.5, 4), (6.0, 2))]
    below = DarkBelow()
    for one in levels:
        below.take(one)
    t, n = np.array([one.exposure_s for one in levels]), np.array([one.count for one in levels])
    means = np.stack([one.mean_dn.ravel() for one in levels])
    expected = np.polyval(np.polyfit(t, means, 1, w=np.sqrt(n)), 2.5).reshape(SHAPE)
    image, variance, how = below.image(2.5)
    np.testing.assert_allclose(image, expected, atol=1e-4)
    design = np.stack([np.ones(4), t], -1)
    error = np.array([1, 2.5]) @ np.linalg.inv(design.T @ (n[:, None] * design)) @ [1, 2.5]
    np.testing.assert_allclose(variance, 4 * error, rtol=1e-5)
    assert "interpolated" in how
    assert below.level_dn(2.5) == pytest.approx(levels[2].levels_dn[0])  # of its own exposure
    assert below.level_dn(4.0) == pytest.approx(np.polyval(np.polyfit(t, means.mean(axis=1), 1, w=np.sqrt(n)), 4.0), abs=1e-4)
    np.testing.assert_array_equal(below.image(0.1)[0], levels[0].mean_dn)  # most frames: kept


def test_one_exposure_serves_itself_only():
    below = DarkBelow()
    below.take(level(1.0, 5))
    assert below.image(1.0)[2] == "darks of 1 s"
    assert "exposure unknown" in below.image(None)[2]
    with pytest.raises(BadInput, match="darks of 1 s only"):
        below.image(2.0)
    with pytest.raises(BadInput, match="darks of 1 s only"):
        below.level_dn(2.0)


def test_an_absurd_unit_of_time_is_refused():
    below = DarkBelow()
    below.take(level(1e-6, 3))
    below.take(level(2e-6, 3, rate=1e9))
    with pytest.raises(BadInput, match="absurd"):
        below.check(4095.0, None)
