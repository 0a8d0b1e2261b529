"""Memory of a measurement: it does not grow with the number of frames, but for a few words of each."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import numpy as np
import pytest

from calibench.measure import dark, flat, transfer
from calibench.records import Frame

SHAPE = (160, 240)
BOOK_BYTES = 5000  # what may be kept of a frame besides its place in the sums: its name, hash, level; its pixels take 76,800


class Frames:
    """So many darks and flats of each of three exposures, made as they are asked for; again and again the same."""

    def __init__(self, count: int, kinds: tuple[str, ...]):
        self._count, self._kinds = count, kinds

    def __iter__(self) -> Iterator[Frame]:
        rng = np.random.default_rng(0)
        for kind in self._kinds:
            for exposure_s in (0.1, 0.2, 0.3):
                light_e = 4e4 * exposure_s if kind == "flat" else 0.0
                for _ in range(self._count):
                    data = np.rint(100 + 0.1 * (rng.poisson(light_e, SHAPE) + rng.normal(0, 40, SHAPE))).astype(np.uint16)
                    yield Frame(data=data, kind=kind, exposure_s=exposure_s, bit_depth=12, white_level_dn=4095.0)


def peak_bytes(measurement, frames: Frames) -> int:
    tracemalloc.start()
    measurement.measure(frames)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


@pytest.mark.parametrize(("measurement", "kinds"), [(dark, ("dark",)), (flat, ("flat", "dark")), (transfer, ("flat", "dark"))])
def test_memory_does_not_grow_with_the_frames(measurement, kinds):
    measurement.measure(Frames(2, kinds))  # loads what is loaded once
    few, many = (peak_bytes(measurement, Frames(count, kinds)) for count in (10, 22))
    assert many - few < 12 * 3 * len(kinds) * BOOK_BYTES
