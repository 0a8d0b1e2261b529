"""The detection threshold for an asked number of false alarms a frame, found on the frame's own threshold map.

A false alarm is rare in a single neighbourhood, so plain simulation would need millions of pixels. Importance sampling with
exponential tilting (Asmussen and Glynn, Stochastic Simulation, chapters V and VI) draws the noise of 3x3 pixels so that the
matched filter's score lies about the threshold, and weighs each draw by how much likelier that made it. Every draw stands at
a pixel of the map, with what its pixels have: Poisson steps of one electron, normal read noise, rounding to whole DN, masked
neighbours. So the count holds for skewed and coarse noise, vignetting and defects alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .detect.kernels import SEED_SIGMA, SHARPEST, SIDE
from .threshold_map import ThresholdMap

FALSE_ALARMS = 1.0  # a frame, asked for unless the caller says otherwise
DRAWS = 8000
TILT = 4.7  # the score about which is drawn
MOST_PUSH = 3.0  # logarithm of the factor by which a pixel's electrons are tilted
SEED = 20220501  # the threshold of a frame is the same each time
LOWEST_K, HIGHEST_K = SEED_SIGMA, 30.0
QUANTISATION_DN2 = 1 / 12
SKEW_CLIP = 3.5
SKEW_SAMPLES = 400_000  # pixels, at least a quarter of which tell: the skewness is good to 0.004 to 0.008
SKEW_LEFT = 0.8535  # of the skewness is left in mean(z^3 - 3 z) within SKEW_CLIP (Edgeworth, first order)


@dataclass(frozen=True, kw_only=True)
class NoiseLaw:
    """How the noise of a pixel is distributed, its variance given. step_dn: the jump of one electron, DN (the gain); 0: all of
    the noise is normal. normal_dn: the part that is normal (read noise, rounding included); the rest comes in steps.
    whole_dn: the frame's values are whole DN."""

    step_dn: float = 0.0
    normal_dn: float = 0.0
    whole_dn: bool = False


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """How much a detector is to find. k_sigma: its threshold; None: the one at which noise of this law gives `false_alarms`
    spots a frame, or its own where it cannot tell."""

    k_sigma: float | None = None
    false_alarms: float = FALSE_ALARMS
    law: NoiseLaw = NoiseLaw()

    def k_on(self, thresholds: ThresholdMap) -> float:
        """The threshold in sigma on a threshold map."""
        return k_for_false_alarms(thresholds, self.false_alarms, self.law) if self.k_sigma is None else self.k_sigma


def k_for_false_alarms(thresholds: ThresholdMap, false_alarms: float, law: NoiseLaw) -> float:
    """Threshold in sigma above which pure noise gives `false_alarms` peaks a frame on average; within 3 to 30."""
    usable = np.isfinite(thresholds.expected_dn)
    usable[[0, -1]] = usable[:, [0, -1]] = False
    if not usable.any():
        return HIGHEST_K
    scores, weights = _draw(thresholds, law, usable)
    order = np.argsort(-scores)
    expected = np.cumsum(weights[order]) * usable.sum() / DRAWS  # false alarms above each score
    row = np.searchsorted(expected, false_alarms)
    return float(np.clip(scores[order][min(row, DRAWS - 1)], LOWEST_K, HIGHEST_K))


def _draw(thresholds: ThresholdMap, law: NoiseLaw, usable: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Scores (DRAWS,) of tilted noise about usable pixels, 0 where the scan would find no peak, and their weights."""
    rng = np.random.default_rng(SEED)
    h, w = usable.shape
    places = np.zeros(0, int)
    while len(places) < DRAWS:  # a draw of pixels of the frame, those in use
        tried = rng.integers(0, h * w, 2 * DRAWS)
        places = np.concatenate([places, tried[usable.ravel()[tried]]])
    around = (places[:DRAWS, None] + (np.arange(-1, 2)[:, None] * w + np.arange(-1, 2)).ravel()).T  # (9, DRAWS)
    expected = thresholds.expected_dn.ravel()[around].astype(float)
    noise, seed = thresholds.noise_dn.ravel()[around].astype(float), thresholds.seed_dn.ravel()[around].astype(float)
    masked = ~np.isfinite(expected)
    kernel = np.where(masked, 0.0, np.outer((SIDE, 1, SIDE), (SIDE, 1, SIDE)).reshape(9, 1)) / noise**2
    kernel /= np.sqrt((kernel**2 * noise**2).sum(0))

    tilt = TILT * kernel
    if law.step_dn > 0:
        tilt = np.minimum(tilt, MOST_PUSH / law.step_dn)
    rounding2 = QUANTISATION_DN2 if law.whole_dn else 0.0
    shot = np.maximum(noise**2 - max(law.normal_dn**2, rounding2), 0.0) if law.step_dn > 0 else np.zeros_like(noise)
    normal2 = np.maximum(noise**2 - shot - rounding2, 0.0)
    deviation = np.sqrt(normal2) * rng.standard_normal(noise.shape) + normal2 * tilt
    log_weight = (0.5 * normal2 * tilt**2).sum(0)
    if law.step_dn > 0:
        electrons = shot / law.step_dn**2
        pushed = electrons * np.exp(law.step_dn * tilt)
        deviation += law.step_dn * (rng.poisson(pushed) - electrons)
        log_weight += (pushed - electrons * (1 + law.step_dn * tilt)).sum(0)
    log_weight -= (tilt * deviation).sum(0)

    value = np.where(masked, 0.0, expected) + deviation
    value = np.rint(value) if law.whole_dn else value
    excess = np.where(masked, -np.inf, value - seed)
    light = np.where(masked, 0.0, value - expected)
    first = np.arange(9)[:, None] < 4
    beaten = ((excess > excess[4]) | ((excess == excess[4]) & first)).any(0)
    sharp = light[4] >= SHARPEST * np.maximum(light, 0).sum(0)
    found = (excess[4] > 0) & ~beaten & ~sharp
    return np.where(found, (kernel * light).sum(0), 0.0), np.exp(log_weight)


def step_from_skewness(signal_dn: np.ndarray, noise_dn: np.ndarray, unusable: np.ndarray) -> float:
    """The jump of one electron that the skewness of a frame's quiet pixels tells (Poisson: third moment = step * variance), DN.

    For a frame whose gain nobody measured. Quiet: within SKEW_CLIP sigma; what the clip takes off is put back to first order.
    0 where the skewness is not significant or negative.
    """
    every = max(1, int(np.sqrt(signal_dn.size / SKEW_SAMPLES)))
    sample = np.s_[::every, ::every]
    z = (signal_dn[sample] / noise_dn[sample])[~unusable[sample]]
    z = z[np.abs(z) < SKEW_CLIP]
    skewness = float((z * (z * z - 3)).mean()) / SKEW_LEFT if len(z) else 0.0
    if len(z) == 0 or skewness < 3 * np.sqrt(6 / len(z)):
        return 0.0
    return skewness * float(np.median(noise_dn[sample]))
