"""A glance: level, blocks and digest from one pass."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.measure._frames.glance import glance
from calibench.records import Frame


def frame(data):
    return Frame(data=data, bit_depth=16, white_level_dn=65535)


def noise(shape, seed=0, high=65536):
    return np.random.default_rng(seed).integers(0, high, shape).astype(np.uint16)


@pytest.mark.parametrize("shape", [(1, 1), (5, 3), (32, 32), (63, 70), (64, 96), (100, 65)])
def test_figures_match_numpy(shape):
    data = noise(shape)
    seen = glance(frame(data))
    assert seen.total_dn == data.sum(dtype=np.int64) and seen.largest == data.max()
    assert seen.at_largest == np.count_nonzero(data == data.max())
    assert seen.level_dn == data.sum(dtype=np.int64) / data.size
    rows, columns = (max(1, n // 32) for n in shape)
    assert seen.blocks_dn.shape == (rows, columns)
    y, x = ([32 * i for i in range(n)] + [side] for n, side in ((rows, shape[0]), (columns, shape[1])))
    means = [[data[y[i]:y[i + 1], x[j]:x[j + 1]].mean() for j in range(columns)] for i in range(rows)]
    np.testing.assert_allclose(seen.blocks_dn, means, rtol=1e-12)


def test_the_share_of_saturated_pixels():
    data = noise((40, 50), high=4000)
    data[:10, :20] = 4095
    assert glance(frame(data)).saturated(4095.0) == 0.1 and glance(frame(data)).at_largest == 200
    assert glance(frame(data)).saturated(2000.0) == np.mean(data >= 2000)
    assert glance(frame(data)).saturated(5000.0) == 0.0


def test_the_digest_tells_frames_apart_and_knows_a_copy():
    data = noise((64, 64), high=4)
    assert glance(frame(data)).digest == glance(frame(data.copy())).digest
    moved = np.roll(data, 1, axis=1)
    assert len({glance(frame(d)).digest for d in (data, moved, np.roll(data, 32, axis=0), noise((64, 64), 1, 4))}) == 4


def test_a_frame_is_looked_at_once_and_never_mistaken_for_another():
    a, b = frame(noise((4, 4))), frame(noise((4, 4), 1))
    assert glance(a) is glance(a)
    assert glance(b).total_dn == b.data.sum() and glance(a).total_dn == a.data.sum()
