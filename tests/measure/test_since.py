"""Defects against the map of another session: the same camera at other temperatures, with pixels that came and went."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.calmap.assemble import assemble
from calibench.measure import dark, flat
from calibench.records import Frame

SHAPE = (90, 120)
ENERGY = 0.62 / 8.617333e-5
NAMES = ("confirmed", "new", "gone", "new_certain", "gone_certain")


@pytest.fixture(scope="module")
def rates():
    """e-/s at 25 C of a camera with 60 hot pixels, and where these are."""
    rng = np.random.default_rng(0)
    rate = 10 * np.exp(0.15 * rng.standard_normal(SHAPE))
    at = np.unravel_index(rng.choice(rate.size, 60, replace=False), SHAPE)
    rate[at] += rng.uniform(30, 300, 60)
    return rate, at


def session(rate, seed, *temperatures_c):
    rng = np.random.default_rng(seed)
    offset = 60 + np.random.default_rng(1).normal(0, 1, SHAPE)
    for celsius in temperatures_c:
        warming = np.exp(-ENERGY * (1 / (celsius + 273.15) - 1 / 298.15))
        for t in (0.001, 0.4, 1.0):
            for i in range(6):
                e = rng.poisson(rate * warming * t) + rng.normal(0, 4, SHAPE)
                yield Frame(data=np.rint(0.5 * e + offset).clip(0, 4095).astype(np.uint16), kind="dark", bit_depth=12,
                            white_level_dn=4095, exposure_s=t, temperature_c=celsius, egain_e_per_dn=2.0,
                            file=f"{seed}_{celsius}_{t}_{i}", sha256=f"{seed}_{celsius}_{t}_{i}")


def map_of(measurement):
    return assemble([measurement], software="test", created="2025-01-01")


@pytest.fixture(scope="module")
def first(rates):
    return map_of(dark.measure(list(session(rates[0], 1, 15.0, 25.0))))


def counts(measurement, name="hot"):
    return {n: measurement.quantity(f"{name}_{n}").value for n in NAMES}


@pytest.mark.parametrize("celsius", [18.0, 25.0, 31.0])
def test_the_same_camera_has_no_certain_change_at_any_temperature(rates, first, celsius):
    found = counts(dark.measure(list(session(rates[0], 2, celsius)), None, first))
    assert found["confirmed"] >= 50
    assert (found["new_certain"], found["gone_certain"]) == (0, 0)


def test_pixels_that_came_and_went_are_told_from_the_others(rates, first):
    rate, (y, x) = rates
    aged = rate.copy()
    aged[y[:8], x[:8]] = 10
    came = [(5, i) for i in range(3, 110, 9)]
    for place in came:
        aged[place] = 150
    found = counts(dark.measure(list(session(aged, 3, 31.0)), None, first))
    assert found["new_certain"] == len(came)
    assert found["gone_certain"] == 8
    assert found["confirmed"] >= 44


def test_without_a_law_no_certain_change_is_claimed_across_temperatures(rates):
    one = map_of(dark.measure(list(session(rates[0], 1, 25.0))))
    measured = dark.measure(list(session(rates[0], 2, 31.0)), None, one)
    assert counts(measured)["new_certain"] is None and "one temperature" in measured.quantity("hot_new_certain").reason
    assert counts(measured)["confirmed"] >= 50


def test_the_same_frames_confirm_nothing(rates, first):
    measured = dark.measure(list(session(rates[0], 1, 15.0, 25.0)), None, first)
    assert set(counts(measured).values()) == {None} and "same frames" in measured.quantity("hot_new").reason


def test_a_map_without_darks_has_nothing_to_confirm(rates, first):
    frames = list(session(rates[0], 1, 25.0))
    assert not [q for q in dark.measure(frames).quantities if "confirmed" in q.name]


def test_dead_and_cold_pixels_of_flats(first):
    def lit(seed, dead):
        rng = np.random.default_rng(seed)
        response = np.ones(SHAPE)
        response[20, dead] = 0.05
        for kind, light in (("flat", 3000.0), ("dark", 0.0)):
            for i in range(6):
                data = np.rint(60 + 0.5 * (rng.poisson(light * response) + rng.normal(0, 4, SHAPE))).astype(np.uint16)
                yield Frame(data=data, kind=kind, bit_depth=12, white_level_dn=4095, exposure_s=0.01, file=f"{kind}{seed}_{i}",
                            sha256=f"{kind}{seed}_{i}")
    before = map_of(flat.measure(list(lit(1, [10, 30, 50]))))
    found = counts(flat.measure(list(lit(2, [30, 50, 70, 90])), None, before), "dead")
    assert found == {"confirmed": 2, "new": 2, "gone": 1, "new_certain": 2, "gone_certain": 1}
