"""Darks and flats that are not what they should be, where nothing but their level says so."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.measure import dark, flat
from calibench.records import Frame

SHAPE = (40, 60)


def frames(kind, light_e_per_s, *, count=3, exposures_s=(0.001, 0.5, 1.0), always_e=0.0):
    rng = np.random.default_rng(1)
    for t in exposures_s:
        for i in range(count):
            e = rng.poisson(always_e + light_e_per_s * t, SHAPE) + rng.normal(0, 4, SHAPE)
            data = np.rint(60 + 0.25 * e).clip(0, 4095).astype(np.uint16)
            yield Frame(data=data, kind=kind, bit_depth=12, white_level_dn=4095, exposure_s=t, file=f"{kind}_{t}_{i}",
                        sha256=f"{kind}_{light_e_per_s}_{always_e}_{t}_{i}")


def said(measurement):
    return [w for w in measurement.warnings if "light comes in" in w]


def test_darks_that_may_be_lit_alike_at_every_exposure_are_said():
    assert said(dark.measure(list(frames("dark", 20.0, always_e=3000.0))))
    assert not said(dark.measure(list(frames("dark", 20.0))))


def test_evenly_lit_darks_below_flats_are_said():
    light = list(frames("flat", 8000.0, exposures_s=(1.0,)))
    assert said(flat.measure([*light, *frames("dark", 3000.0, exposures_s=(1.0,))]))
    assert not said(flat.measure([*light, *frames("dark", 20.0, exposures_s=(1.0,))]))


def test_one_flat_says_what_it_cannot_know():
    measured = flat.measure([*frames("flat", 8000.0, exposures_s=(1.0,), count=1), *frames("dark", 20.0, exposures_s=(1.0,))])
    assert any("one flat a level" in w for w in measured.warnings)
    assert measured.quantity("gain_dn_per_e").value is None and measured.quantity("gain_dn_per_e").reason


def darks(rate_e_per_s, *, exposures_s=(0.001, 0.5, 1.0), fall_dn_per_s=0.0, spread=0.15, count=3, shape=(64, 96)):
    """Darks whose rate differs from pixel to pixel by `spread`."""
    rng = np.random.default_rng(3)
    rate = rate_e_per_s * np.exp(spread * rng.standard_normal(shape))
    for t in exposures_s:
        for i in range(count if np.isscalar(count) else count[exposures_s.index(t)]):
            e = rng.poisson(rate * t) + rng.normal(0, 4, shape)
            data = np.rint(60 - fall_dn_per_s * t + 0.25 * e).clip(0, 4095).astype(np.uint16)
            yield Frame(data=data, kind="dark", bit_depth=12, white_level_dn=4095, exposure_s=t, file=f"{t}_{i}",
                        sha256=f"{t}_{i}")


def test_a_rate_as_even_as_light_is_refused_and_dark_current_is_not():
    with pytest.raises(BadInput, match="the darks are lit"):
        dark.measure(list(darks(4000.0, spread=0.01)))
    measured = dark.measure(list(darks(4000.0)))
    assert said(measured) and any("fills the range" in w for w in measured.warnings)
    assert measured.quantity("dark_rate_dn_per_s").value == pytest.approx(1000 * np.exp(0.15**2 / 2), rel=0.01)
    assert not any("fills the range" in w for w in dark.measure(list(darks(20.0))).warnings)


def test_evenly_lit_darks_below_flats_are_refused():
    light = list(frames("flat", 8000.0, exposures_s=(1.0,)))
    with pytest.raises(BadInput, match="the darks are lit"):
        flat.measure([*light, *frames("dark", 4000.0)])


def test_darks_that_get_darker_with_exposure():
    with pytest.raises(BadInput, match="darker with exposure"):
        dark.measure(list(darks(0.0, fall_dn_per_s=50.0)))
    assert any("no dark current" in w for w in dark.measure(list(darks(0.0, fall_dn_per_s=5.0))).warnings)
    assert not any("no dark current" in w for w in dark.measure(list(darks(0.0))).warnings)


def test_an_exposure_with_one_dark_lends_its_noise_and_says_so():
    measured = dark.measure(list(darks(20.0, count=(3, 1, 3))))
    assert any("one frame only of 0.5 s" in w and "that of 0.001 s" in w for w in measured.warnings)
    assert measured.quantity("read_noise_dn").value == pytest.approx(1.0, abs=0.02)
    alone = dark.measure(list(darks(20.0, count=1)))
    for name in ("read_noise_dn", "read_noise_e", "dsnu_1288_dn", "dsnu_raw_dn", "dsnu_core_dn"):
        assert alone.quantity(name).value is None and alone.quantity(name).reason
    assert alone.quantity("offset_dn").value == pytest.approx(60.0, abs=0.1)


def test_a_level_with_one_flat_has_no_part_in_the_gain():
    light = [*frames("flat", 8000.0, exposures_s=(0.5,)), *frames("flat", 8000.0, exposures_s=(1.0,), count=1)]
    measured = flat.measure([*light, *frames("dark", 20.0)])
    assert any(w.startswith("one flat only at 20") for w in measured.warnings)
    assert "1 level" in measured.quantity("gain_dn_per_e").source
