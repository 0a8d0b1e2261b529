"""Dark current against temperature: the activation energy of an Arrhenius law, and the doubling temperature that follows.

    rate(T) = rate(T0) * exp(-E / k * (1 / T - 1 / T0)),     T in kelvin
Silicon's dark current from its depletion region goes with half of the band gap, about 0.6 eV, from the bulk with all of it
(Widenhorn et al. 2002). The doubling temperature at T0 is ln 2 * k * T0^2 / E: a fixed "6 to 8 K" is no law.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ...calmap.thermal import BOLTZMANN_EV_PER_K, ZERO_C_K, warming

START_EV = 0.6
MOST_EV = 3.0


@dataclass(frozen=True, kw_only=True)
class Activation:
    """energy_ev with its 1-sigma error; doubling_c: at the reference temperature. rate: of the fitted law at the reference."""

    energy_ev: float
    energy_uncertainty_ev: float
    doubling_c: float
    doubling_uncertainty_c: float
    reference_c: float
    rate: float


def activation(celsius: np.ndarray, rate: np.ndarray, error: np.ndarray, reference_c: float) -> Activation | None:
    """The law through rates at two temperatures or more; None where they show no growth beyond their errors.

    Least squares in the rates themselves, which may be negative within their errors where it is cold. The error is widened
    where the rates scatter more about the law than their errors allow.
    """
    celsius, rate, error = (np.asarray(values, float) for values in (celsius, rate, error))
    unit = float(np.max(np.abs(rate)))
    if len(rate) < 2 or unit == 0:
        return None

    def residual(p: np.ndarray) -> np.ndarray:
        return (p[0] * unit * warming(celsius, reference_c, p[1]) - rate) / error

    nearest = rate[int(np.argmin(np.abs(celsius - reference_c)))] / unit
    fitted = least_squares(residual, [max(nearest, 1e-6), START_EV], bounds=([0, -MOST_EV], [np.inf, MOST_EV]),
                           x_scale=[1, 0.1])
    try:
        covariance = np.linalg.inv(fitted.jac.T @ fitted.jac)
    except np.linalg.LinAlgError:
        return None
    freedom = len(rate) - 2
    wider = max(1.0, np.sqrt(2 * fitted.cost / freedom)) if freedom else 1.0
    energy, uncertainty = float(fitted.x[1]), float(wider * np.sqrt(covariance[1, 1]))
    if not energy > 3 * uncertainty:
        return None
    doubling = np.log(2) * BOLTZMANN_EV_PER_K * (reference_c + ZERO_C_K) ** 2 / energy
    return Activation(energy_ev=energy, energy_uncertainty_ev=uncertainty, doubling_c=float(doubling), reference_c=reference_c,
                      doubling_uncertainty_c=float(doubling * uncertainty / energy), rate=float(fitted.x[0] * unit))
