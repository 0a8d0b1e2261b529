"""Numbers as text: digits that the uncertainty bears, no false zeros, nothing that is not finite."""

from __future__ import annotations

import math

import numpy as np
import pytest

from calibench.records import Quantity
from calibench.report.numbers import (
    MISSING,
    fixed,
    number,
    percent,
    plural,
    power_of_ten,
    rounded_like,
    sentence,
    sigma,
    stated,
    with_uncertainty,
)
from calibench.report.section import Badge, Table
from calibench.report.tables import quantity_table


@pytest.mark.parametrize(("value", "digits", "text"), [
    (1416.6667, 6, "1416.67"), (0.032954, 3, "0.0330"), (-2.5, 2, "−2.5"), (25.0, 4, "25"), (0.0, 4, "0"),
    (0.00005, 2, "5.0 × 10⁻⁵"),
    (12345678.9, 3, "1.23 × 10⁷"), (123456.7, 3, "123457"), (np.float32(0.5), 2, "0.50"), (None, 4, MISSING),
    (math.nan, 4, MISSING), (math.inf, 4, MISSING),
])
def test_number(value, digits, text):
    assert number(value, digits) == text


@pytest.mark.parametrize(("value", "uncertainty", "text"), [
    (1416.2345, 0.1723, "1416.23 ± 0.17"), (-0.36994, 0.00149, "−0.3699 ± 0.0015"), (0.000281, 2.5e-5, "0.000281 ± 0.000025"),
    (12345.6, 230.0, "12350 ± 230"), (64.0, 1.0, "64.0 ± 1.0"), (9.85, None, "9.850"), (9.85, 0.0, "9.850"),
    (9.85, math.inf, "9.850"),
    (None, 0.1, MISSING), (math.nan, 0.1, MISSING),
])
def test_a_value_has_as_many_digits_as_its_uncertainty_bears(value, uncertainty, text):
    assert with_uncertainty(value, uncertainty) == text
    if uncertainty is not None and "±" in text:
        assert rounded_like(value, uncertainty) == text.split(" ±")[0]


def test_small_figures_of_speech():
    assert (sigma(0.1723), sigma(0.1723, 3), sigma(None), sigma(math.inf)) == ("0.17", "0.52", MISSING, MISSING)
    assert (stated(0.0001), stated(0.2), stated(-40.0)) == ("0.0001", "0.2", "−40")
    assert (fixed(-0.123456, 3), fixed(math.nan, 3)) == ("−0.123", MISSING)
    assert (power_of_ten(1.2e-149), power_of_ten(0.0)) == ("1.2 × 10⁻¹⁴⁹", "0")
    assert (percent(0.0343), plural(1, "view"), plural(0, "view")) == ("3.43 %", "1 view", "0 views")
    assert sentence("two spots", "", "one star") == "Two spots; one star."


def test_a_quantity_without_a_value_says_why():
    table = quantity_table("t", [Quantity(name="strehl", value=None, unit="1", reason="needs the f-number", symbol="S")])
    assert table.rows == (("strehl (S)", MISSING, MISSING, "", "needs the f-number"),)


def test_a_table_refuses_rows_and_columns_that_do_not_fit():
    with pytest.raises(ValueError, match="another length"):
        Table(title="t", columns=("a", "b"), rows=(("1",),))
    with pytest.raises(ValueError, match="unknown columns"):
        Table(title="t", columns=("a",), rows=(), numbers=frozenset({"z"}))


@pytest.mark.parametrize(("status", "tone"), [("pass", "good"), ("solved", "good"), ("fail", "bad"), ("too_few_spots", "bad"),
                                              ("skipped", "open")])
def test_tone_of_a_status(status, tone):
    assert Badge(status=status).tone == tone


def test_a_figure_whose_square_came_out_negative_is_an_upper_limit():
    assert with_uncertainty(0.0, 0.13) == "< 0.13"
    assert with_uncertainty(0.0, None) == "0"
