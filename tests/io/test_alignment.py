"""Left-aligned data are recognised by their values, and nothing else is taken for them."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.io.alignment import empty_low_bits, left_shift_of, right_aligned


def values(bits: int = 12, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 2**bits, (50, 70)).astype(np.uint16)


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_left_aligned_data_come_back(bits):
    data, depth, said = right_aligned(values(bits) << (16 - bits), bit_depth=None, alignment=None)
    np.testing.assert_array_equal(data, values(bits))
    assert depth == bits and "left-aligned" in said


def test_clipping_to_the_full_word_does_not_hide_it():
    data = values() << 4
    data[:3] = 65535
    shifted, depth, _ = right_aligned(data, bit_depth=None, alignment=None)
    assert depth == 12 and shifted.max() == 4095


def test_right_aligned_data_stay():
    data, depth, said = right_aligned(values(), bit_depth=None, alignment=None)
    assert depth == 16 and "4095" in said
    np.testing.assert_array_equal(data, values())


@pytest.mark.parametrize("data", [np.zeros((9, 9), np.uint16), np.full((9, 9), 4096, np.uint16),
                                  np.full((9, 9), 65535, np.uint16), np.repeat([[0, 64]], 9, 0).astype(np.uint16)])
def test_few_values_prove_nothing(data):
    assert left_shift_of(data) == 0


def test_empty_low_bits():
    assert empty_low_bits(np.array([[16, 48, 65535]], np.uint16)) == 4
    assert empty_low_bits(np.array([[1, 16]], np.uint16)) == 0


def test_a_stated_depth_settles_weak_evidence():
    data = np.array([[0, 64], [128, 256]], np.uint16)
    assert right_aligned(data, bit_depth=12, alignment="right")[1:] == (12, None)
    shifted, depth, _ = right_aligned(data, bit_depth=12, alignment="left")
    assert depth == 12 and shifted.max() == 16


def test_stated_depth_and_left_aligned_values_agree():
    shifted, depth, _ = right_aligned(values() << 4, bit_depth=12, alignment=None)
    assert depth == 12
    np.testing.assert_array_equal(shifted, values())


@pytest.mark.parametrize(("depth", "alignment"), [(10, None), (10, "right"), (8, "left"), (None, "left")])
def test_values_that_do_not_fit_are_refused(depth, alignment):
    with pytest.raises(BadInput):
        right_aligned(values(), bit_depth=depth, alignment=alignment)
