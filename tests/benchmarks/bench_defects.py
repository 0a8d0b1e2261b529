"""Defects: recall and false alarms over hot fractions, with and without a glow; telegraph pixels. `make bench`.

1 Mpx, read noise 4 e-, DSNU 2 e-, dark current 5 e-/s with a lognormal spread of 15 %, hot rates exponential with a mean of
60 e-/s, 20 darks at each of 0.1, 1 and 5 s; the glow adds up to 10 e- in the longest exposure along x.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from calibench.measure import dark
from calibench.records import DEFECT_FLAGS, Frame

SHAPE = (1024, 1024)
MPX = SHAPE[0] * SHAPE[1] / 1e6
GAIN_DN_PER_E, OFFSET_DN, READ_E, DSNU_E, RATE_E_PER_S, SPREAD = 0.5, 100.0, 4.0, 2.0, 5.0, 0.15
HOT_MEAN_E_PER_S, GLOW_E, EXPOSURES_S, COUNT = 60.0, 10.0, (0.1, 1.0, 5.0), 20


class Darks:
    """Frames made anew at each pass, so that none is kept. lift_e(i): what is added to frame i."""

    def __init__(self, rate: np.ndarray, seed: int, exposures=EXPOSURES_S, count=COUNT, lift_e=lambda i: 0.0):
        self.rate, self.seed, self.exposures, self.count, self.lift_e = rate, seed, exposures, count, lift_e
        self.offset = OFFSET_DN + GAIN_DN_PER_E * DSNU_E * np.random.default_rng(seed).standard_normal(rate.shape)

    def __iter__(self) -> Iterator[Frame]:
        for k, t in enumerate(self.exposures):
            for i in range(self.count):
                rng = np.random.default_rng((self.seed, k, i))
                charge = rng.poisson(self.rate * t) + READ_E * rng.standard_normal(self.rate.shape) + self.lift_e(i)
                data = np.clip(np.rint(self.offset + GAIN_DN_PER_E * charge), 0, 4095).astype(np.uint16)
                yield Frame(data=data, kind="dark", bit_depth=12, white_level_dn=4095, exposure_s=t,
                            egain_e_per_dn=1 / GAIN_DN_PER_E, file=f"{t:g}s/{i}.png")


def flagged(result, *names):
    return (result.maps["defects"] & sum(DEFECT_FLAGS[name] for name in names)) > 0


@pytest.mark.parametrize("glow", [False, True])
@pytest.mark.parametrize("fraction", [1e-3, 1e-2, 3e-2])
def test_recall_and_false_alarms(fraction, glow, capsys):
    rng = np.random.default_rng((int(1e4 * fraction), glow))
    base = RATE_E_PER_S * np.exp(SPREAD * rng.standard_normal(SHAPE))
    base += glow * GLOW_E / EXPOSURES_S[-1] * np.linspace(0, 1, SHAPE[1])
    excess = np.where(rng.random(SHAPE) < fraction, rng.exponential(HOT_MEAN_E_PER_S, SHAPE), 0)
    started = time.process_time()
    result = dark.measure(Darks(base + excess, 7))
    seconds = time.process_time() - started
    rate = result.maps["dark_rate_dn_per_s"] / GAIN_DN_PER_E
    normal = excess == 0
    sigma = np.std((rate - base + (base - np.median(base, axis=0)))[normal])  # of the normal population, the glow taken off
    strong = excess >= 8 * sigma
    found, thesis = flagged(result, "hot", "warm"), flagged(result, "hot_thesis")
    limit = result.quantity("hot_detection_limit_e_per_s")
    near = (excess > 0.97 * limit.value) & (excess < 1.03 * limit.value)
    recall, false = found[strong].mean(), np.count_nonzero(found & normal) / MPX
    with capsys.disabled():
        print(f"\nhot {fraction:g}{' glow' if glow else ''}: sigma {sigma:.2f} e-/s, recall {recall:.4f} of {strong.sum()}, "
              f"false {false:.1f} a Mpx; 99 % limit {limit.value:.1f} e-/s, found there {found[near].mean():.3f} of "
              f"{near.sum()}; mean + 5 sigma: {thesis[strong].mean():.3f}; {seconds:.1f} CPU s with the making of the frames")
    assert recall >= 0.99 and false <= 1


def test_telegraph_pixels(capsys):
    rng = np.random.default_rng(5)
    frames, number = 200, 2000
    where = rng.choice(SHAPE[0] * SHAPE[1], number, replace=False)
    states = np.array([_switching(rng, frames) for _ in range(number)])
    noise_e = np.hypot(READ_E, np.sqrt(RATE_E_PER_S * 0.1))

    def lift_e(i):
        image = np.zeros(SHAPE)
        image.flat[where] = 5 * noise_e * states[:, i]
        return image

    result = dark.measure(Darks(RATE_E_PER_S * np.exp(SPREAD * rng.standard_normal(SHAPE)), 9, (0.1,), frames, lift_e))
    found, truth = flagged(result, "telegraph"), np.zeros(SHAPE, bool)
    truth.flat[where] = True
    with capsys.disabled():
        print(f"\ntelegraph, step of 5 noises, {frames} frames: {found[truth].mean():.4f} found, "
              f"{np.count_nonzero(found & ~truth) / MPX:.1f} false a Mpx")
    assert found[truth].mean() >= 0.9 and np.count_nonzero(found & ~truth) <= MPX


def _switching(rng: np.random.Generator, frames: int) -> np.ndarray:
    """A two-level signal with a duty of 10 to 90 % and at least 4 switches."""
    while True:
        up, down = rng.uniform(0.01, 0.5, 2)
        state, out = rng.random() < 0.5, []
        for _ in range(frames):
            state ^= rng.random() < (down if state else up)
            out.append(state)
        if 0.1 <= np.mean(out) <= 0.9 and np.count_nonzero(np.diff(out)) >= 4:
            return np.array(out)
