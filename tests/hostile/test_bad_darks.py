"""Darks and flats that are not what they should be, where nothing but their level says so."""

from __future__ import annotations

import numpy as np
import pytest

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


@pytest.mark.parametrize("light", [{"light_e_per_s": 3000.0}, {"light_e_per_s": 20.0, "always_e": 3000.0}])
def test_evenly_lit_darks_are_said(light):
    assert said(dark.measure(list(frames("dark", **light))))
    assert not said(dark.measure(list(frames("dark", 20.0))))


def test_evenly_lit_darks_below_flats_are_said():
    light = list(frames("flat", 8000.0, exposures_s=(1.0,)))
    assert said(flat.measure([*light, *frames("dark", 3000.0, exposures_s=(1.0,))]))
    assert not said(flat.measure([*light, *frames("dark", 20.0, exposures_s=(1.0,))]))


def test_one_flat_says_what_it_cannot_know():
    measured = flat.measure([*frames("flat", 8000.0, exposures_s=(1.0,), count=1), *frames("dark", 20.0, exposures_s=(1.0,))])
    assert any("one flat a level" in w for w in measured.warnings)
    assert measured.quantity("gain_dn_per_e").value is None and measured.quantity("gain_dn_per_e").reason
