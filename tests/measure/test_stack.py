"""Stacks: exact sums in one pass, noise without the common drift."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure._frames.stack import Accumulator, accumulate
from calibench.records import Frame


def frame(data):
    return Frame(data=data, bit_depth=16, white_level_dn=65535)


def test_sums_are_exact_and_match_numpy():
    rng = np.random.default_rng(0)
    cube = rng.integers(40000, 65536, (7, 12, 17)).astype(np.uint16)
    stack = accumulate(frame(d) for d in cube)
    np.testing.assert_array_equal(stack.sum_dn, cube.sum(axis=0, dtype=np.int64))
    np.testing.assert_array_equal(stack.sum_sq_dn2, (cube.astype(np.int64) ** 2).sum(axis=0))
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


def cube_of(count, shape=(12, 17), low=0, high=65536, seed=0):
    return np.random.default_rng(seed).integers(low, high, (count, *shape)).astype(np.uint16)


def stacked(cube, dtype=np.uint16):
    accumulator = Accumulator()
    for data in cube:
        accumulator.add(frame(data.astype(dtype)))
    return accumulator


def two_pass(cube):
    """Steady variance, by floats and two passes: each pixel less its regression on the level (few frames: less the level)."""
    cube = cube.astype(float)
    level = np.rint(256 * cube.mean(axis=(1, 2))) / 256  # the stack counts levels in these steps
    d, x = cube - cube.mean(axis=0), level - level.mean()
    n = len(cube)
    slope = np.tensordot(x, d, 1) / (x @ x) if n >= 4 else np.ones(cube.shape[1:])
    return ((d - x[:, None, None] * slope) ** 2).sum(axis=0) / (n - 2 if n >= 4 else n - 1)


@pytest.mark.parametrize("count", [2, 3, 4, 7, 8, 9, 16, 21])
@pytest.mark.parametrize("high", [200, 65536])
def test_every_batch_length_matches_two_passes_of_floats(count, high):
    cube = cube_of(count, high=high, seed=count)
    series = stacked(cube).series()
    np.testing.assert_array_equal(series.stack.sum_dn, cube.sum(axis=0, dtype=np.int64))
    np.testing.assert_allclose(series.stack.variance_dn2, cube.astype(float).var(axis=0, ddof=1), rtol=1e-12)
    np.testing.assert_allclose(series.steady_variance_dn2, two_pass(cube), rtol=1e-6, atol=1e-6 * high**2)
    np.testing.assert_allclose(series.levels_dn, cube.mean(axis=(1, 2)), rtol=1e-15)


def test_a_pixel_that_never_changes_has_no_variance_at_all():
    cube = cube_of(9)
    cube[:, 3, 4] = 60001
    assert stacked(cube).series().stack.variance_dn2[3, 4] == 0


def test_sums_hold_ten_thousand_frames_of_the_full_range():
    # one pixel black in the first frame and white after, its neighbour the other way round
    cube = np.zeros((4, 2, 2), np.uint16)
    cube[1:, 0, 0], cube[0, 0, 1], cube[1:, 1] = 65535, 65535, (65535, 0)
    accumulator, frames, n = Accumulator(), [frame(data) for data in cube], 10_000
    accumulator.add(frames[0])
    for i in range(1, n):
        accumulator.add(frames[1 + i % 3])
    stack = accumulator.series().stack
    for pixel, first, rest in (((0, 0), 0, 65535), ((0, 1), 65535, 0), ((1, 0), 0, 65535)):
        assert int(stack.sum_dn[pixel]) == first + (n - 1) * rest
        assert int(stack.sum_sq_dn2[pixel]) == first**2 + (n - 1) * rest**2
        assert stack.variance_dn2[pixel] == pytest.approx(65535.0**2 / n, rel=1e-14)


def test_sums_that_would_overflow_are_refused():
    accumulator = Accumulator()
    accumulator.add(frame(np.array([[0, 0]], np.uint16)))
    accumulator._levels *= 32768  # as if so many frames had been added
    with pytest.raises(BadInput, match="do not fit into exact sums"):
        accumulator.add(frame(np.array([[0, 65535]], np.uint16)))


@pytest.mark.parametrize(("first", "second"), [(3, 5), (8, 9), (1, 12), (0, 4), (6, 0)])
def test_merged_accumulators_hold_the_sums_of_one(first, second):
    # levels far apart, so that the two count their weights from different levels
    cube = np.concatenate([cube_of(first, high=3000, seed=1), cube_of(second, low=50000, seed=2)])
    merged, other, one = stacked(cube[:first]), stacked(cube[first:]), stacked(cube)
    merged.merge(other)
    assert (merged.count, merged.level_dn) == (one.count, one.level_dn)
    a, b = merged.series(), one.series()
    np.testing.assert_array_equal(a.stack.sum_dn, b.stack.sum_dn)
    np.testing.assert_array_equal(a.stack.sum_sq_dn2, b.stack.sum_sq_dn2)
    np.testing.assert_allclose(a.steady_variance_dn2, b.steady_variance_dn2, rtol=1e-5)
    merged.add(frame(cube_of(1)[0]))
    if second:  # the other is left as it was
        np.testing.assert_array_equal(other.series().stack.sum_dn, stacked(cube[first:]).series().stack.sum_dn)


def test_merge_refuses_another_size():
    with pytest.raises(BadInput, match="17, 12.*12, 17|12, 17.*17, 12"):
        stacked(cube_of(2)).merge(stacked(cube_of(2, shape=(17, 12))))


def test_a_series_stays_as_it_was_when_frames_follow():
    cube = cube_of(12)
    accumulator = stacked(cube[:9])
    series = accumulator.series()
    kept = series.stack.sum_sq_dn2.copy()
    for data in cube[9:]:
        accumulator.add(frame(data))
    np.testing.assert_array_equal(accumulator.series().stack.variance_dn2, stacked(cube).series().stack.variance_dn2)
    np.testing.assert_array_equal(series.stack.sum_sq_dn2, kept)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.int32, np.float64])
def test_whole_numbers_of_any_type_are_taken(dtype):
    cube = cube_of(5, high=250)
    np.testing.assert_array_equal(stacked(cube, dtype).series().stack.variance_dn2, stacked(cube).series().stack.variance_dn2)


def test_values_below_zero_and_beyond_16_bits_are_taken_and_mixed_types_too():
    cube = np.random.default_rng(3).integers(-5000, 200_000, (6, 4, 5)).astype(np.float32)
    accumulator = stacked(cube, np.float32)
    accumulator.add(frame(cube_of(1, (4, 5))[0]))
    both = np.concatenate([cube, cube_of(1, (4, 5))])
    np.testing.assert_allclose(accumulator.series().stack.variance_dn2, both.astype(float).var(axis=0, ddof=1), rtol=1e-12)


def test_values_too_wide_for_exact_sums_are_refused():
    with pytest.raises(BadInput, match="wider than 21 bits"):
        accumulate([frame(np.full((3, 4), 2.0**23, np.float32))])


def test_a_large_frame_is_taken_block_by_block():
    cube = cube_of(11, shape=(61, 83), high=4096)  # several blocks of the kernel, the last one short
    series = stacked(cube).series()
    np.testing.assert_array_equal(series.stack.sum_dn, cube.sum(axis=0, dtype=np.int64))
    np.testing.assert_allclose(series.steady_variance_dn2, two_pass(cube), rtol=1e-6, atol=1)
