"""Error bars of photon transfer: how often the truth lies within one sigma, over repeated small series.

The bench bench_transfer.py does this over 1000 seeds; here 60 seeds must lie within what chance allows of 68 %.
"""

from __future__ import annotations

import numpy as np
import pytest

from calibench.measure import transfer

SEEDS = 60
TRUTH = {"gain_dn_per_e": 0.25, "quantum_efficiency_percent": 60.0, "read_noise_e": 4.0, "dark_current_e_per_s": 20.0,
         "dsnu_raw_pixel_e": 3.0, "prnu_raw_pixel_percent": 1.0, "dsnu_raw_column_e": 1.5, "prnu_raw_row_percent": 0.4,
         "dsnu_raw_e": np.sqrt(12.25), "noise_correlation_x": 0.0}


@pytest.fixture(scope="module")
def pulls(light_ladder):
    found = []
    for seed in range(SEEDS):
        measured = transfer.measure(light_ladder(1000 + seed, size_px=(64, 48), levels=14, stack=8))
        found.append([(measured.quantity(n).value - v) / measured.quantity(n).uncertainty for n, v in TRUTH.items()])
    return dict(zip(TRUTH, np.array(found).T, strict=True))


@pytest.mark.parametrize("name", TRUTH)
def test_truth_lies_within_one_sigma_about_as_often_as_said(pulls, name):
    inside = np.mean(np.abs(pulls[name]) <= 1)
    chance = np.sqrt(0.68 * 0.32 / SEEDS)
    assert abs(inside - 0.68) < 3.2 * chance
    assert abs(pulls[name].mean()) < 0.6


def test_all_figures_together(pulls):
    together = np.concatenate(list(pulls.values()))
    assert abs(np.mean(np.abs(together) <= 1) - 0.68) < 0.06
