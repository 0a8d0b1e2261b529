"""Error bars of the sensor measurements: how often the truth lies within one sigma, every figure that states one. `make bench`.

Small frames of a camera drawn anew by each seed, so that the patterns' scatter counts too. The goal is 68 +- 4 %.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from scipy.optimize import brentq

from calibench.measure import dark, flat, transfer
from calibench.measure._nonuniformity import LINE_NOISE_GAIN, NOISE_GAIN
from calibench.records import Frame

SEEDS = int(os.environ.get("CALIBENCH_SEEDS", "1000"))
K, QE, READ_E, RATE, OFFSET_DN, WHITE_DN = 0.25, 0.6, 4.0, 20.0, 60.0, 4095
DSNU_E, PRNU_PERCENT = (3.0, 1.0, 1.5), (1.0, 0.4, 0.3)  # of pixels, rows, columns
LEVELS, SHORTEST_S = 20, 0.001
AT_TOP = 2.878  # a share of 0.002 of a normal population lies above this
ENERGY_EV, BOLTZMANN = 0.62, 8.617333e-5
SHAPE = (48, 64)


def nonuniformity(what, unit, sds):
    """Truth of the raw and the high-passed figures; the high-pass keeps NOISE_GAIN of pixels, LINE_NOISE_GAIN of lines."""
    pixel, row, column = sds
    passed = np.sqrt(NOISE_GAIN * pixel**2 + LINE_NOISE_GAIN * (row**2 + column**2))
    kept = {"raw": (1, 1, 1), "1288": np.sqrt([NOISE_GAIN, LINE_NOISE_GAIN, LINE_NOISE_GAIN])}
    return {f"{what}_raw_{unit}": np.linalg.norm(sds), f"{what}_1288_{unit}": passed, f"{what}_core_{unit}": passed} | {
        f"{what}_{kind}_{part}_{unit}": sd * gain for kind, gains in kept.items()
        for part, sd, gain in zip(("pixel", "row", "column"), sds, gains, strict=True)}


def transfer_truth():
    top_e = (WHITE_DN - 0.5 - OFFSET_DN) / K
    full_e = brentq(lambda e: e + AT_TOP * np.sqrt(e + READ_E**2 + sum(np.square(DSNU_E)) + sum(np.square(PRNU_PERCENT))
                                                   * (e / 100) ** 2) - top_e, 1e3, top_e)
    dark_dn2 = K**2 * (READ_E**2 + RATE * SHORTEST_S) + 1 / 12
    read_dn, least_e = np.sqrt(dark_dn2 - 1 / 12), np.sqrt(dark_dn2 / K**2 + 0.25) + 0.5
    return {
        "gain_dn_per_e": K, "gain_e_per_dn": 1 / K, "responsivity_dn_per_photon": K * QE,
        "quantum_efficiency_percent": 100 * QE,
        "dark_noise_dn": np.sqrt(dark_dn2), "read_noise_dn": read_dn, "read_noise_e": read_dn / K,
        "absolute_threshold_e": least_e, "absolute_threshold_photons": least_e / QE, "saturation_dn": K * full_e,
        "saturation_photons": full_e / QE, "saturation_e": full_e, "snr_max": np.sqrt(full_e),
        "snr_max_db": 10 * np.log10(full_e), "snr_max_inverse_percent": 100 / np.sqrt(full_e),
        "dynamic_range": full_e / least_e, "dynamic_range_db": 20 * np.log10(full_e / least_e), "linearity_error_percent": 0.0,
        "offset_dn": OFFSET_DN, "dark_rate_dn_per_s": K * RATE, "dark_current_e_per_s": RATE,
        "dark_current_from_variance_e_per_s": RATE, "noise_correlation_x": 0.0, "noise_correlation_y": 0.0,
        "crosstalk_x_percent": 0.0, "crosstalk_y_percent": 0.0, "frame_correlation": 0.0,
        **nonuniformity("dsnu", "e", DSNU_E), **nonuniformity("prnu", "percent", PRNU_PERCENT)}


def pattern(rng, sds):
    """(H, W), sum of pixels, rows and columns, without its mean."""
    parts = sum(sd * rng.standard_normal(shape) for sd, shape in zip(sds, (SHAPE, (SHAPE[0], 1), (1, SHAPE[1])), strict=True))
    return parts - parts.mean()


def shot(rng, charge_e, fixed_e, **stated):
    data = np.rint(K * (rng.poisson(charge_e) + READ_E * rng.standard_normal(SHAPE) + fixed_e) + OFFSET_DN).clip(0, WHITE_DN)
    return Frame(data=data.astype(np.uint16), bit_depth=12, white_level_dn=WHITE_DN, **stated)


def darks(seed):
    """At 15 and 25 C, three exposures, four frames of each."""
    rng = np.random.default_rng(seed)
    fixed_e = pattern(rng, DSNU_E)
    for celsius in (15.0, 25.0):
        warming = np.exp(-ENERGY_EV / BOLTZMANN * (1 / (celsius + 273.15) - 1 / 298.15))
        for t in (SHORTEST_S, 0.5, 1.0):
            for i in range(4):
                yield shot(rng, np.full(SHAPE, RATE * 5 * warming * t), fixed_e, kind="dark", exposure_s=t,
                           temperature_c=celsius, egain_e_per_dn=1 / K, file=f"d{celsius}_{t}_{i}",
                           sha256=f"{seed}_{celsius}_{t}_{i}")


def flats(seed):
    """Four levels of light by exposure, four frames each, and darks of each exposure."""
    rng = np.random.default_rng(seed)
    fixed_e, response = pattern(rng, DSNU_E), 1 + pattern(rng, PRNU_PERCENT) / 100
    for kind, light_e in (("flat", 8000.0), ("dark", 0.0)):
        for t in (0.25, 0.5, 0.75, 1.0):
            for i in range(4):
                yield shot(rng, light_e * t * response, fixed_e, kind=kind, exposure_s=t / 100, file=f"{kind}{t}_{i}",
                           sha256=f"{seed}{kind}{t}_{i}")


DARK_TRUTH = {"offset_dn": OFFSET_DN, "read_noise_dn": K * np.sqrt(READ_E**2 + 5 * RATE * SHORTEST_S),
              "read_noise_e": np.sqrt(READ_E**2 + 5 * RATE * SHORTEST_S), "dark_rate_dn_per_s": 5 * K * RATE,
              "dark_current_e_per_s": 5 * RATE, "dark_activation_ev": ENERGY_EV,
              "dark_doubling_c": np.log(2) * BOLTZMANN * 298.15**2 / ENERGY_EV,
              **{f"dsnu_{kind}_{unit}": factor * value for unit, factor in (("e", 1.0), ("dn", K))
                 for kind, value in ((k, nonuniformity("dsnu", "e", DSNU_E)[f"dsnu_{k}_e"]) for k in ("raw", "1288", "core"))}}
FLAT_TRUTH = {"gain_dn_per_e": K, "gain_e_per_dn": 1 / K,
              **{name: value for name, value in nonuniformity("prnu", "percent", PRNU_PERCENT).items() if name.count("_") == 2}}


def judged(name, measured, truth):
    """Prints each figure's share within one sigma and its normalised error, and gives the shares."""
    shares = {}
    print(f"\n  {name}, {len(measured)} seeds")
    for figure, value in truth.items():
        found = np.array([(q.value, q.uncertainty) for q in (m.quantity(figure) for m in measured)], float)
        pulls = (found[:, 0] - value) / found[:, 1]
        shares[figure] = float(np.mean(np.abs(pulls) <= 1))
        print(f"  {figure:38s} within 1 sigma {100 * shares[figure]:5.1f} %   {pulls.mean():+.2f} +- {pulls.std():.2f}")
    return shares


def assert_honest(shares):
    chance = np.sqrt(0.68 * 0.32 / SEEDS)
    assert all(abs(share - 0.68) < 0.04 + 2 * chance for share in shares.values()), shares


def test_transfer(light_ladder):
    """The ladder's last step ends anywhere between two levels: seeds draw it over two whole steps."""
    def measured(seed):
        at = np.random.default_rng(10**6 + seed).uniform(17.2, 19.2)
        return transfer.measure(light_ladder(seed, levels=LEVELS, reach=LEVELS / at, longest_s=SHORTEST_S * LEVELS))
    assert_honest(judged("transfer", [measured(seed) for seed in range(SEEDS)], transfer_truth()))


@pytest.mark.parametrize(("measurement", "series", "truth"), [(dark, darks, DARK_TRUTH), (flat, flats, FLAT_TRUTH)])
def test_dark_and_flat(measurement, series, truth):
    measured = [measurement.measure(list(series(seed))) for seed in range(SEEDS)]
    assert_honest(judged(measurement.__name__, measured, truth))


@pytest.mark.parametrize("coupling", [0.005, 0.01, 0.02])
def test_gain_without_crosstalk(light_ladder, coupling):
    """752 x 480, 24 levels, mean of four seeds."""
    found = [transfer.measure(light_ladder(seed, size_px=(752, 480), levels=24, stack=0, coupling=coupling))
             for seed in range(4)]
    plain, corrected = (np.array([m.quantity(f"gain_{n}dn_per_e").value for m in found]) / K - 1
                        for n in ("", "crosstalk_corrected_"))
    stated = found[0].quantity("gain_crosstalk_corrected_dn_per_e").uncertainty / K
    shared = np.mean([[m.quantity(f"crosstalk_{axis}_percent").value for axis in "xy"] for m in found])
    print(f"\n  coupling {100 * coupling:.1f} %: found {shared:.3f} %; K off by {100 * plain.mean():+.2f} %, corrected by "
          f"{100 * corrected.mean():+.3f} % (each +- {100 * stated:.2f} %)")
    assert abs(corrected.mean()) < 0.002
