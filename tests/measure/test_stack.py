"""Stacks: exact sums in one pass, noise without the common drift."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure._stack import Accumulator, accumulate
from calibench.records import Frame


def frame(data):
    return Frame(data=data, bit_depth=16, white_level_dn=65535)


def test_sums_are_exact_and_match_numpy():
    rng = np.random.default_rng(0)
    cube = rng.integers(40000, 65536, (7, 12, 17)).astype(np.uint16)
    stack = accumulate(frame(d) for d in cube)
    np.testing.assert_array_equal(stack.sum_dn + stack.shift_dn * 7, cube.sum(axis=0, dtype=np.int64))
    np.testing.assert_allclose(stack.mean_dn, cube.mean(axis=0), rtol=1e-15)
    np.testing.assert_allclose(stack.variance_dn2, cube.astype(float).var(axis=0, ddof=1), rtol=1e-9)


def test_one_frame_has_a_mean_and_no_variance():
    stack = accumulate([frame(np.full((3, 4), 7, np.uint16))])
    assert stack.count == 1 and (stack.mean_dn == 7).all() and np.isnan(stack.variance_dn2).all()


def test_drift_common_to_all_pixels_is_not_their_noise():
    rng = np.random.default_rng(1)
    accumulator = Accumulator()
    for i in range(10):
        accumulator.add(frame(np.rint(rng.normal(500 + 30 * i, 4, (60, 60))).astype(np.uint16)))
    series = accumulator.series()
    assert series.stack.variance_dn2.mean() > 1000
    assert series.freedom == 8
    assert series.steady_variance_dn2.mean() == pytest.approx(16 + 1 / 12, rel=0.03)


def test_no_frames_other_sizes_and_averaged_frames_are_refused():
    with pytest.raises(BadInput, match="no frames"):
        accumulate([])
    with pytest.raises(BadInput, match="image size"):
        accumulate([frame(np.zeros((3, 4), np.uint16)), frame(np.zeros((4, 3), np.uint16))])
    with pytest.raises(BadInput, match="whole DN"):
        accumulate([frame(np.full((3, 4), 1.5, np.float32))])
