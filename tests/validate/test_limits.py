"""Acceptance limits: pass, fail, or skipped with the reason."""

from __future__ import annotations

import math

import pytest

from calibench.errors import BadInput
from calibench.records import Limit, Quantity
from calibench.validate.limits import judge

NOISE = Quantity(name="read_noise_e", value=4.5, unit="e-", uncertainty=0.2)
QUANTITIES = {"dark.read_noise_e": NOISE,
              "dark.dsnu_1288_e": Quantity(name="dsnu_1288_e", value=None, unit="e-", reason="the gain is unknown"),
              "dark.offset_dn": Quantity(name="offset_dn", value=math.nan, unit="DN")}


def verdict(quantity="read_noise_e", measurement="dark", **limit):
    return judge(QUANTITIES, [Limit(measurement=measurement, quantity=quantity, **limit)])[0]


@pytest.mark.parametrize(("limit", "status"), [
    ({"maximum": 5.0}, "pass"), ({"maximum": 4.0}, "fail"), ({"minimum": 4.0}, "pass"), ({"minimum": 5.0}, "fail"),
    ({"minimum": 4.0, "maximum": 5.0}, "pass"), ({"maximum": 4.5}, "pass"), ({"minimum": 4.5}, "pass"),
    ({"minimum": 0.0, "maximum": 0.0}, "fail"),
])
def test_a_value_is_held_against_both_bounds(limit, status):
    found = verdict(**limit)
    assert (found.status, found.value, found.uncertainty) == (status, 4.5, 0.2)


def test_the_reason_says_on_which_side_and_how_surely():
    assert "above 4" in verdict(maximum=4.0).reason and "reaches" not in verdict(maximum=4.0).reason
    assert "below 4.6" in verdict(minimum=4.6).reason and "reaches across" in verdict(minimum=4.6).reason
    assert "reaches across" in verdict(maximum=4.6).reason


def test_what_has_no_value_is_skipped_with_its_reason():
    assert verdict("dsnu_1288_e", maximum=1.0).status == "skipped"
    assert verdict("dsnu_1288_e", maximum=1.0).reason == "the gain is unknown"
    assert verdict("offset_dn", maximum=1.0).status == "skipped"


def test_what_was_not_measured_is_skipped_and_says_what_there_is():
    assert verdict(measurement="flat", maximum=1.0).reason == "flat was not measured"
    assert "read_noise_e" in verdict("read_noise", maximum=1.0).reason


def test_a_limit_in_another_unit_judges_nothing():
    found = verdict(maximum=5.0, unit="DN")
    assert found.status == "skipped" and "DN" in found.reason and "e-" in found.reason
    assert verdict(maximum=5.0, unit="e-").status == "pass"


@pytest.mark.parametrize("limit", [{}, {"minimum": 2.0, "maximum": 1.0}, {"maximum": math.nan}])
def test_a_limit_that_bounds_nothing_is_bad_input(limit):
    with pytest.raises(BadInput, match="dark.read_noise_e"):
        verdict(**limit)


def test_verdicts_come_in_the_order_of_the_limits():
    limits = [Limit(measurement="dark", quantity="read_noise_e", maximum=m) for m in (5.0, 4.0, 6.0)]
    assert [v.status for v in judge(QUANTITIES, limits)] == ["pass", "fail", "pass"]
