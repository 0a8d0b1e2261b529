"""Series that are not one: mixed settings, automatics at work, duplicates."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.io.frame_seen import seen
from calibench.io.series_checks import Groups, check_series, refuse_automatic
from calibench.records import Frame


def frame(level_dn: float = 500.0, *, kind="flat", exposure_s=0.1, seed=0, size=(40, 60), noise_dn=10.0, **said) -> Frame:
    data = np.random.default_rng(seed).normal(level_dn, noise_dn, size[::-1]).clip(0, 1023).astype(np.uint16)
    return seen(Frame(**{"data": data, "kind": kind, "bit_depth": 10, "white_level_dn": 1023.0, "exposure_s": exposure_s,
                         "file": f"{kind}_{seed}.png", "sha256": f"{seed}"} | said))


def require_alike(frames):
    groups = Groups()
    for one in frames:
        groups.add(one)
    groups.require_one()


@pytest.mark.parametrize(("other", "column"), [({"size": (41, 60)}, "size"), ({"bit_depth": 12}, "bits"),
                                               ({"gain_setting": 4.0}, "gain"), ({"bayer_pattern": "RGGB"}, "Bayer"),
                                               ({"camera": "B"}, "camera")])
def test_mixed_series_are_refused_with_a_table(other, column):
    alike = {"gain_setting": 2.0, "bayer_pattern": "GRBG", "camera": "A"}
    frames = [frame(**alike, seed=i) for i in range(3)] + [frame(**(alike | other), seed=9)]
    with pytest.raises(BadInput) as error:
        require_alike(frames)
    message = str(error.value)
    assert f"mixed in {column}" in message and "flat_0.png" in message and "flat_9.png" in message
    assert len([line for line in message.splitlines() if line.strip()[:1] in "13"]) == 2


def test_what_a_frame_does_not_state_mixes_with_any():
    require_alike([frame(gain_setting=2.0), frame(seed=1)])


def test_flats_of_one_exposure_with_stepping_levels():
    frames = [frame(dn, seed=i) for i, dn in enumerate((400, 405, 520, 660, 655, 520))]
    with pytest.raises(BadInput, match=r"6 flats state one exposure \(0.1 s\).*automatic"):
        refuse_automatic(frames)


def test_a_lamp_may_drift():
    refuse_automatic([frame(500 * (1 + 0.02 * i), seed=i) for i in range(6)])


def test_one_odd_frame_is_left_to_the_measurement():
    refuse_automatic([frame(500, seed=i) for i in range(6)] + [frame(900, seed=9)])


def test_flats_whose_level_stays_while_exposures_differ():
    frames = [frame(500, exposure_s=0.01 * 2**i, seed=i) for i in range(4)]
    with pytest.raises(BadInput, match="level stays"):
        refuse_automatic(frames)


def test_an_honest_exposure_ladder_passes_up_to_saturation():
    refuse_automatic([frame(64 + 100 * 2**i, exposure_s=0.01 * 2**i, seed=i) for i in range(6)])


def test_darks_with_a_gain_that_steps():
    frames = [frame(64 if i % 2 else 160, kind="dark", noise_dn=2.0, seed=i) for i in range(6)]
    with pytest.raises(BadInput, match="6 darks state one exposure"):
        refuse_automatic(frames)


def test_darks_warm_up_where_they_state_it():
    refuse_automatic([frame(64 + 20 * i, kind="dark", temperature_c=20.0 + 3 * i, seed=i) for i in range(5)])


def test_dark_ladders_rise():
    refuse_automatic([frame(64 + 300 * t, kind="dark", exposure_s=t, seed=i) for i, t in enumerate((0.1, 0.5, 1.0, 2.0))])


def test_frames_without_an_exposure_claim_nothing():
    refuse_automatic([frame(10 * (i + 1), kind="dark", exposure_s=None, seed=i) for i in range(8)])


def test_duplicates_are_said():
    frames = check_series([frame(seed=1), frame(seed=2), frame(seed=1, file="copy.png")])
    assert "flat_1.png" in frames[2].notes[-1] and not frames[1].notes


def test_a_black_frame_is_shifted_like_its_series():
    rich = Frame(data=np.full((60, 40), 700, np.uint16), bit_depth=12, white_level_dn=4095.0, sha256="a",
                 notes=("left-aligned 12-bit data in 16 bits (all values are multiples of 16); shifted right by 4 bits",))
    poor = Frame(data=np.full((60, 40), 16, np.uint16), bit_depth=16, white_level_dn=65535.0, sha256="b", kind="dark")
    for frames in ((rich, poor), (poor, rich)):
        found = dict(zip([f.sha256 for f in frames], check_series([seen(f) for f in frames]), strict=True))["b"]
        assert (found.bit_depth, found.white_level_dn, found.largest_dn, found.level_dn) == (12, 4095.0, 1, 1.0)
        settled = found.settle(poor)
        assert (settled.bit_depth, settled.white_level_dn, settled.data.max()) == (12, 4095.0, 1)
        assert "like the rest of the series" in settled.notes[0]
