"""The tolerance study on three-star groups, at a lean count."""

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.io.star_table import load_star_table
from calibench.records import CalibrationMap, Intrinsics, Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.validate.trials import tolerance


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    return SkyCatalogue.seen_by(load_star_table(), Observer())


def test_pattern_survives_ten_percent_of_a_pixel_and_area_moment_reaches_its_ceiling(sky, monkeypatch):
    lens = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=375.5, cy_px=239.5, distortion=[-0.3, 0.2, 0, 0],
                      image_size_px=(752, 480), covariance=np.zeros((8, 8)))
    calmap = CalibrationMap(image_size_px=(752, 480), intrinsics=lens, measured=frozenset({"intrinsics"}))
    monkeypatch.setattr(tolerance, "GROUPS", 150)
    monkeypatch.setattr(tolerance, "ERRORS_PERCENT", (0.08, 10.0))
    found, _ = tolerance.trial([None], calmap, lambda case: LostInSpace(sky=sky))
    rows = [dict(zip(found.columns, row, strict=True)) for row in found.rows]
    assert [row["error_percent_px"] for row in rows] == [0.08, 10.0]
    assert all(row["groups"] > 10_000 and row["pattern_percent"] >= 99 for row in rows)
    for row in rows:
        assert row["area_polar_moment_percent"] >= row["area_moment_ceiling_percent"] - 1 > 94
    # Where the error is as large as the groups differ, nothing can tell them apart, and the study shows it.
    monkeypatch.setattr(tolerance, "ERRORS_PERCENT", (300.0,))
    monkeypatch.setattr(tolerance, "GROUPS", 40)
    rough = dict(zip(found.columns, tolerance.trial([None], calmap, lambda case: LostInSpace(sky=sky))[0].rows[0], strict=True))
    assert rough["area_moment_ceiling_percent"] < 60 and rough["pattern_percent"] < 99


def test_without_a_lens_it_says_so(sky):
    with pytest.raises(BadInput, match="lens"):
        tolerance.trial([None], CalibrationMap(image_size_px=(752, 480)), lambda case: LostInSpace(sky=sky))
