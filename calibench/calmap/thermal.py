"""The law by which a dark rate follows the temperature (Arrhenius): what a map needs to be used at another temperature."""

from __future__ import annotations

import numpy as np

BOLTZMANN_EV_PER_K = 8.617333262e-5
ZERO_C_K = 273.15


def warming(celsius: np.ndarray | float, reference_c: float, energy_ev: float) -> np.ndarray | float:
    """Dark rate at a temperature over that at the reference."""
    inverse_k = 1 / (np.asarray(celsius, float) + ZERO_C_K) - 1 / (reference_c + ZERO_C_K)
    return np.exp(-energy_ev / BOLTZMANN_EV_PER_K * inverse_k)
