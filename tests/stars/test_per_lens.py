"""What follows from a lens alone is computed once for each record."""

import gc

from calibench.records import Intrinsics
from calibench.stars.per_lens import MOST_LENSES, per_lens


def lens_of(focal_px: float) -> Intrinsics:
    return Intrinsics.pinhole(focal_px=focal_px, image_size_px=(64, 48))


def test_once_a_record_and_never_anothers():
    asked = []

    @per_lens
    def focal(lens: Intrinsics) -> float:
        asked.append(lens.fx_px)
        return lens.fx_px
    lens = lens_of(100.0)
    assert focal(lens) == focal(lens) == 100 and asked == [100]
    for i in range(3 * MOST_LENSES):  # freed at once: later records lie at the addresses of earlier ones
        assert focal(lens_of(float(i + 1))) == i + 1
    gc.collect()
    assert focal(lens) == 100
