"""The law of the dark rate's temperature."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.calmap.thermal import BOLTZMANN_EV_PER_K, warming


def test_the_doubling_temperature_doubles():
    reference_c, energy_ev = 20.0, 0.63
    doubling_c = np.log(2) * BOLTZMANN_EV_PER_K * 293.15**2 / energy_ev  # 8.1 K, from the slope of the law at its reference
    assert warming(reference_c, reference_c, energy_ev) == 1
    small = warming(reference_c + 0.01 * doubling_c, reference_c, energy_ev)
    assert small == pytest.approx(2**0.01, rel=1e-5)
    assert warming(reference_c + doubling_c, reference_c, 0.0) == 1
