"""Odd frames in a series are named; lamps that drift, ladders and noise are not."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.measure._frames.glance import glance
from calibench.measure._frames.ledger import Ledger
from calibench.measure._frames.watch import Watch
from calibench.measure.dark import Settings
from calibench.records import Frame

SHAPE = (256, 320)
Y, X = np.mgrid[-0.5:0.5:SHAPE[0] * 1j, -0.5:0.5:SHAPE[1] * 1j]


def frame(i, level, *, kind="flat", exposure_s=0.1, noise=20.0, seed=None):
    data = np.random.default_rng(i if seed is None else seed).normal(level, noise, SHAPE)
    return Frame(data=np.rint(data).clip(0, 4095).astype(np.uint16), kind=kind, bit_depth=12, white_level_dn=4095,
                 exposure_s=exposure_s, file=f"{i}.png", sha256=str(i))


def warnings(frames):
    watch = Watch()
    for one in frames:
        watch.take(one, glance(one))
    return watch.warnings


FIELD = 2000 * (1 - 0.4 * (X**2 + Y**2))  # vignetted
DARK = 100 + 30 * np.exp(-((X - 0.5) ** 2 + (Y - 0.5) ** 2) / 0.02)  # amplifier glow


@pytest.mark.parametrize("seed", range(5))
def test_frames_taken_alike_are_not_odd(seed):
    flats = [frame(i, FIELD, seed=100 * seed + i) for i in range(12)]
    darks = [frame(i, DARK, kind="dark", noise=3, seed=100 * seed + i) for i in range(12)]
    assert warnings(flats) == warnings(darks) == ()


def test_drift_ladders_and_pairs_of_levels_are_not_odd():
    assert warnings([frame(i, FIELD * (1 + 0.004 * i)) for i in range(15)]) == ()
    assert warnings([frame(i, 100 + FIELD * 1.3 ** (i // 2) / 10) for i in range(16)]) == ()
    assert warnings([frame(i, 100 + FIELD * 1.3**i / 10) for i in range(10)]) == ()
    assert warnings([frame(i, DARK + 4 * (i // 3), kind="dark", exposure_s=float(i // 3), noise=3) for i in range(12)]) == ()


@pytest.mark.parametrize("odd", [0, 1, 5, 10, 11])
@pytest.mark.parametrize(("kind", "change", "sign"), [
    ("flat", 1 + 0.03 * X, "gradient"), ("flat", 1 + 0.02 * np.sin(18 * Y), "bands"),
    ("dark", 3 * X + 0 * Y, "gradient"), ("dark", 1.5 * np.sin(18 * Y), "bands")])
def test_the_one_odd_frame_is_named(kind, change, sign, odd):
    field, noise = (FIELD, 20) if kind == "flat" else (DARK, 3)
    levels = [(field * change if kind == "flat" else field + change) if i == odd else field for i in range(12)]
    found = warnings([frame(i, level, kind=kind, noise=noise) for i, level in enumerate(levels)])
    assert len(found) == 1 and found[0].startswith(f"{odd}.png (1 of 12 {kind}s of 0.1 s): ")
    assert sign in found[0]


@pytest.mark.parametrize(("kind", "field", "jump", "said"), [("flat", FIELD, 28, "1.5 %"), ("dark", DARK, 2, "2 DN")])
def test_a_level_that_jumps_is_named_with_its_size(kind, field, jump, said):
    found = warnings([frame(i, field + (jump if i == 4 else 0), kind=kind, noise=3) for i in range(9)])
    assert [w for w in found if w.startswith("4.png") and "jumps" in w and said in w]


def test_light_that_flickers_in_every_frame_is_one_sentence():
    found = warnings([frame(i, FIELD * (1 + 0.02 * np.sin(18 * Y + 2.1 * i))) for i in range(20)])
    assert len(found) == 1 and "and 17 more (20 of 20 flats" in found[0] and "bands" in found[0]


def test_copies_of_the_pixels_under_another_header_are_rejected():
    ledger = Ledger(Settings(), "darks")
    taken = [ledger.take(frame(i, DARK, kind="dark", noise=3, seed=i % 3)) for i in range(5)]
    assert taken == [True, True, True, False, False]
    assert [reason.split(",")[0] for _, reason in ledger.rejected] == ["the same pixels as 0.png", "the same pixels as 1.png"]


def test_frames_without_noise_may_be_alike():
    ledger = Ledger(Settings(), "darks")
    assert all(ledger.take(frame(i, np.full(SHAPE, 7.0), kind="dark", noise=0)) for i in range(3))


def test_warnings_reach_the_ledger():
    ledger = Ledger(Settings(), "flats")
    for i in range(6):
        ledger.take(frame(i, FIELD * (1 + 0.05 * X) if i == 3 else FIELD))
    assert any(w.startswith("3.png") for w in ledger.warnings)
