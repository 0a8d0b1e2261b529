"""The count of false matches at the leanest count, and that it would see dishonest odds."""

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.io.star_table import load_star_table
from calibench.records import CalibrationMap, Intrinsics, Observer
from calibench.stars import kernels, verify
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.validate.trials import false_match

LENS = Intrinsics.pinhole(focal_px=1416.7, image_size_px=(752, 480), focal_sd_px=0.0)
CALMAP = CalibrationMap(image_size_px=(752, 480), intrinsics=LENS, measured=frozenset({"intrinsics"}))


@pytest.fixture(scope="module")
def finder() -> LostInSpace:
    return LostInSpace(sky=SkyCatalogue.seen_by(load_star_table(), Observer()))


def wrong_rates(finder) -> dict[tuple[str, float], float]:
    found, _ = false_match.trial([None], CALMAP, lambda case: finder)
    rows = [dict(zip(found.columns, row, strict=True)) for row in found.rows]
    assert all(row["solved"] >= row["wrong"] for row in rows)
    assert any(0 < row["solved"] < row["sets"] and row["wrong"] == 0 for row in rows)  # part of the truth: right ones
    return {(row["spots"], row["limit"]): row["wrong_rate"] for row in rows}


def test_wrong_answers_are_no_oftener_than_stated(finder, monkeypatch):
    monkeypatch.setattr(false_match, "SETS", 40)
    rates = wrong_rates(finder)
    assert len(rates) == 2 * len(false_match.LIMITS)
    for (_, limit), rate in rates.items():
        assert rate <= limit + 4 * np.sqrt(limit / 40)


def test_odds_that_forget_the_length_of_the_search_are_seen(finder, monkeypatch):
    """The same search whose probabilities are stated a million times too small."""
    honest = kernels.judge_known

    def boastful(*arguments):
        row, probability, *rest = honest(*arguments)
        return row, probability * 1e-6, *rest
    monkeypatch.setattr(verify.kernels, "judge_known", boastful)
    monkeypatch.setattr(false_match, "SETS", 60)
    monkeypatch.setattr(false_match, "LIMITS", (1e-6,))
    assert wrong_rates(finder)[false_match.NOTHING, 1e-6] > 1e-6 + 4 * np.sqrt(1e-6 / 60)


def test_a_wrong_answer_among_stars_is_counted(finder, monkeypatch):
    monkeypatch.setattr(false_match, "is_wrong", lambda found, truth, noise_px: True)
    monkeypatch.setattr(false_match, "SETS", 10)
    found, _ = false_match.trial([None], CALMAP, lambda case: finder)
    part = [row for row in found.rows if row[0] == false_match.PART]
    assert part[0][3] > 0 and all(row[3] == row[4] for row in part)


def test_without_a_lens_it_says_so(finder):
    with pytest.raises(BadInput, match="lens"):
        false_match.trial([None], CalibrationMap(image_size_px=(752, 480)), lambda case: finder)
