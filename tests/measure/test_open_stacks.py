from __future__ import annotations

import itertools

import numpy as np
import pytest

from calibench.measure._dark.levels import DarkLevels
from calibench.measure._frames.open_stacks import BYTES_A_PIXEL, OpenStacks
from calibench.measure._frames.stack import BATCH
from calibench.records import Frame

SHAPE = (12, 20)


def frames(order, seed=0):
    rng = np.random.default_rng(seed)
    return [Frame(data=np.rint(rng.normal(100 + key, 3, SHAPE)).astype(np.uint16), bit_depth=12, white_level_dn=4095.0,
                  kind="dark", exposure_s=float(key)) for key in order]


def given_up(order, most):
    stacks = OpenStacks(most * BYTES_A_PIXEL * SHAPE[0] * SHAPE[1])
    closed = [stacks.add(frame.exposure_s, frame) for frame in frames(order)]
    return [one for one in closed if one is not None], list(stacks.empty())


def test_levels_that_follow_one_another_are_each_given_up_once():
    closed, rest = given_up(np.repeat(range(7), 3), most=3)
    assert sorted((key, stack.count) for key, stack in [*closed, *rest]) == [(float(i), 3) for i in range(7)]


def test_levels_that_take_turns_stay_whole_but_for_the_last_slot():
    closed, rest = given_up(list(range(4)) * 10, most=4)
    assert not closed and [stack.count for _, stack in rest] == [10] * 4
    closed, _ = given_up(list(range(5)) * 10, most=4)
    assert len(closed) < 15  # about one a turn; giving up the oldest would be 46


def test_no_more_than_a_batch_of_frames_waits():
    stacks = OpenStacks()
    for frame in frames(list(range(6)) * 5):
        stacks.add(frame.exposure_s, frame)
        assert sum(stacks[key].waiting for key in {f.exposure_s for f in frames(range(6))} if key in stacks) <= BATCH


@pytest.mark.parametrize("turns", [True, False])
def test_the_order_of_darks_does_not_change_their_levels(turns):
    every = frames(np.repeat(range(3), 9))
    order = list(itertools.chain(*zip(*(every[9 * i:9 * i + 9] for i in range(3)), strict=True))) if turns else every[::-1]
    one, other = DarkLevels(), DarkLevels()
    for frame in every:
        one.add(frame)
    for frame in order:
        other.add(frame)
    for a, b in zip(one.groups()[0][0], other.groups()[0][0], strict=True):
        np.testing.assert_array_equal(a.mean_dn, b.mean_dn)
        np.testing.assert_allclose(a.variance_dn2, b.variance_dn2, rtol=1e-5)
