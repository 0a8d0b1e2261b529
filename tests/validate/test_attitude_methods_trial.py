"""The comparison of attitude methods at the leanest count."""

import pytest

from calibench import registry
from calibench.errors import BadInput
from calibench.io.star_table import load_star_table
from calibench.records import CalibrationMap, Intrinsics, Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.validate import simulated_spots
from calibench.validate.simulated_spots import Condition
from calibench.validate.trials import attitude_methods

LENS = Intrinsics.pinhole(focal_px=1416.7, image_size_px=(752, 480), focal_sd_px=0.0)
CALMAP = CalibrationMap(image_size_px=(752, 480), intrinsics=LENS, measured=frozenset({"intrinsics"}))


def test_errors_follow_the_noise_and_error_bars_hold(monkeypatch):
    monkeypatch.setattr(attitude_methods, "FRAMES", 12)
    monkeypatch.setattr(simulated_spots, "CONDITIONS", {"clean": Condition(), "noise 1 px": Condition(noise_px=1.0)})
    finder = LostInSpace(sky=SkyCatalogue.seen_by(load_star_table(), Observer()))
    found, _ = attitude_methods.trial([None], CALMAP, lambda case: finder)
    row = {(r[0], r[1]): dict(zip(found.columns, r, strict=True)) for r in found.rows}
    names = registry.names("calibench.stars.attitude")
    assert len(row) == 2 * len(names)
    for name in names:
        quiet, loud = row["clean", name], row["noise 1 px", name]
        assert 3 < loud["cross_arcsec"] / quiet["cross_arcsec"] < 8 and quiet["roll_arcsec"] > quiet["cross_arcsec"]
        assert 0.4 < quiet["nees"] < 2 and quiet["solved"] == quiet["frames"]
        assert name == "triad" or quiet["cross_arcsec"] == pytest.approx(row["clean", "svd"]["cross_arcsec"], rel=1e-3)
    assert row["clean", "triad"]["cross_arcsec"] > 2 * row["clean", "svd"]["cross_arcsec"]


def test_without_a_lens_it_says_so():
    with pytest.raises(BadInput, match="lens"):
        attitude_methods.trial([None], CalibrationMap(image_size_px=(752, 480)), lambda case: None)
