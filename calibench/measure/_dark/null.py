"""How normal pixels are distributed, learned from the pixels themselves: the null against which defects are judged.

Dark rates are lognormal over a sensor and its noise has tails, so a Gaussian threshold lets tens of sound pixels pass. Hot
pixels lie on the right only: the left side and the middle belong to the normal ones. Tukey's g-and-h distribution
    z(u) = centre + scale * (exp(g u) - 1) / g * exp(h u^2 / 2),     u standard normal, g >= 0, h >= 0
(Hoaglin 1985) is fitted to those quantiles; g is the skewness of a lognormal, h the weight of both tails. The share of pixels
on the right that do not belong to it is estimated alongside and taken out (an empirical null, Efron 2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr, ndtri

LOWEST_U, HIGHEST_U, NODES = -4.3, 1.5, 30  # the quantiles used, in standard deviations
FEWEST_BELOW = 10  # pixels below a quantile that is used
APART_U = 2.5  # the surplus beyond this quantile is not of the normal population
ROUNDS = 4
MOST_G, MOST_H = 1.0, 0.2


@dataclass(frozen=True, kw_only=True)
class Null:
    """Tukey's g-and-h of the normal pixels' z."""

    centre: float
    scale: float
    g: float
    h: float

    def quantile(self, u: np.ndarray | float) -> np.ndarray | float:
        """z that stands where u stands in the standard normal distribution."""
        return self.centre + self.scale * _g_and_h(u, self.g, self.h)

    def threshold(self, pixels: int, expected: float) -> float:
        """z that `expected` of `pixels` normal pixels exceed."""
        return float(self.quantile(-ndtri(min(expected / pixels, 0.5))))


def fit_null(z: np.ndarray) -> Null:
    """The null of deviations z (any shape) of which hot pixels, on the right only, may be a part."""
    ordered = np.sort(z, axis=None)
    nodes = np.linspace(LOWEST_U, HIGHEST_U, NODES)
    found, apart = np.array([0.0, 1.0, 0.05, 0.0]), 0.0
    for _ in range(ROUNDS):
        below = ndtr(nodes) * (1 - apart) * ordered.size
        used = below > FEWEST_BELOW
        u, quantiles = nodes[used], ordered[below[used].astype(int)].astype(float)
        if len(u) < 2 * len(found):  # too few pixels for a shape of their own
            return Null(centre=float(np.median(ordered)), scale=_scale(ordered), g=0.0, h=0.0)
        weight = np.exp(-(u**2) / 2) / np.sqrt(ndtr(u) * ndtr(-u))  # one over the error of a quantile, but for a factor
        start = np.array([np.median(ordered), max(_scale(ordered), 1e-12), *found[2:]])

        def residual(p: np.ndarray, u: np.ndarray = u, quantiles: np.ndarray = quantiles, weight: np.ndarray = weight,
                     unit: float = start[1]) -> np.ndarray:
            return weight * (p[0] + p[1] * _g_and_h(u, p[2], p[3]) - quantiles) / unit

        found = least_squares(residual, np.clip(start, [-np.inf, 0, 0, 0], [np.inf, np.inf, MOST_G, MOST_H]), x_scale=(
            start[1], start[1], 0.1, 0.01), bounds=([-np.inf, 0, 0, 0], [np.inf, np.inf, MOST_G, MOST_H])).x
        beyond = found[0] + found[1] * _g_and_h(APART_U, found[2], found[3])
        apart = max(0.0, 1 - np.searchsorted(ordered, beyond) / ordered.size - ndtr(-APART_U))
    centre, scale, g, h = (float(v) for v in found)
    return Null(centre=centre, scale=scale, g=g, h=h)


def _g_and_h(u: np.ndarray | float, g: float, h: float) -> np.ndarray | float:
    return (np.expm1(g * u) / g if g > 1e-6 else u) * np.exp(h * np.square(u) / 2)


def _scale(ordered: np.ndarray) -> float:
    """Standard deviation from the lower half: median minus the 15.87 % quantile."""
    middle, low = (float(ordered[int(p * (ordered.size - 1))]) for p in (0.5, ndtr(-1)))
    return middle - low
