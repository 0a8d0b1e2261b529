"""The comparison of identifiers at the leanest count."""

import numpy as np
import pytest

from calibench import registry
from calibench.errors import BadInput
from calibench.io.star_table import load_star_table
from calibench.records import CalibrationMap, Identification, Intrinsics, Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.validate import simulated_spots
from calibench.validate.simulated_spots import Condition, is_wrong, look
from calibench.validate.trials import identifiers

LENS = Intrinsics.pinhole(focal_px=1416.7, image_size_px=(752, 480), focal_sd_px=0.0)
CALMAP = CalibrationMap(image_size_px=(752, 480), intrinsics=LENS, measured=frozenset({"intrinsics"}))


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    return SkyCatalogue.seen_by(load_star_table(), Observer())


def test_every_identifier_is_compared_and_none_is_wrong(sky, monkeypatch):
    monkeypatch.setattr(identifiers, "FRAMES", 2)
    few = {name: simulated_spots.CONDITIONS[name] for name in ("clean", "4 stars")}
    monkeypatch.setattr(simulated_spots, "CONDITIONS", few)
    found, _ = identifiers.trial([None], CALMAP, lambda case: LostInSpace(sky=sky))
    rows = [dict(zip(found.columns, row, strict=True)) for row in found.rows]
    names = list(registry.names("calibench.stars.identify"))
    assert [row["identifier"] for row in rows] == 2 * names and all(row["wrong"] == 0 for row in rows)
    assert all(row["table_mb"] > 0 and row["table_s"] > 0 for row in rows)
    clean, few = (np.mean([row["solved_percent"] for row in part]) for part in (rows[:len(names)], rows[len(names):]))
    assert clean > 90 and few < 60  # four stars leave hardly any to be verified against


def test_conditions_do_what_they_say_and_a_wrong_answer_is_seen(sky):
    truth, spots = look(sky, LENS, Condition(most=8, false=3), np.random.default_rng(1))
    assert len(spots) == 11
    all_stars, half_of_them = Condition(most=999), Condition(most=999, missing=0.5)
    whole, half = (len(look(sky, LENS, condition, np.random.default_rng(1))[1])
                   for condition in (all_stars, half_of_them))
    assert 0.2 * whole < half < 0.8 * whole
    found = LostInSpace(sky=sky).identify(spots, (752, 480), lens=LENS)
    assert isinstance(found, Identification) and found.status == "solved" and not is_wrong(found, truth, 0.2)
    assert is_wrong(found, truth[[1, 0, 2]] * [[1], [-1], [1]], 0.2)


def test_without_a_lens_it_says_so(sky):
    with pytest.raises(BadInput, match="lens"):
        identifiers.trial([None], CalibrationMap(image_size_px=(752, 480)), lambda case: LostInSpace(sky=sky))
