"""Lab sessions that should not give a calibration: each is refused with a message that names the frame and the cure."""

from __future__ import annotations

import numpy as np
import pytest

from calibench import registry
from calibench.errors import BadInput
from calibench.records import Frame

SHAPE = (96, 128)
MEASUREMENTS = ("intrinsics", "dark", "flat", "psf")


def frame(level_dn, *, seed=0, shape=SHAPE, file="frame.png", kind="unknown", **said):
    data = np.random.default_rng(seed).normal(level_dn, 3, shape)
    about = {"bit_depth": 12, "white_level_dn": 4095, "exposure_s": 0.1} | said
    data = np.clip(np.rint(data), 0, about["white_level_dn"]).astype(np.uint16)
    return Frame(data=data, file=file, kind=kind, **about)


def measure(name, frames):
    return registry.load("calibench.measure", name).measure(frames)


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_nothing_at_all(name):
    with pytest.raises(BadInput, match="no .* were given"):
        measure(name, [])


@pytest.mark.parametrize("name", MEASUREMENTS)
@pytest.mark.parametrize("odd", [{"shape": (96, 96)}, {"gain_setting": 8.0}, {"bit_depth": 10, "white_level_dn": 1023}])
def test_mixed_sessions_name_the_odd_frame(name, odd):
    said = {"gain_setting": 1.0} | odd
    frames = [frame(100, seed=1, file="a.png", gain_setting=1.0), frame(100, seed=2, file="odd.png", **said)]
    with pytest.raises(BadInput, match=r"odd\.png: .*not one session"):
        measure(name, frames)


def test_a_bright_dark_names_the_frame():
    frames = [frame(100, seed=i, file=f"{i}.png") for i in range(3)]
    with pytest.raises(BadInput, match=r"lit\.png: no dark frame: its level is 3000"):
        measure("dark", [*frames, frame(3000, file="lit.png")])


def test_a_light_leak_names_the_frame():
    leak = frame(100, file="leak.png").data + np.linspace(0, 800, SHAPE[1]).astype(np.uint16)
    with pytest.raises(BadInput, match=r"leak\.png: .*light comes in"):
        measure("dark", [frame(100), Frame(data=leak, bit_depth=12, white_level_dn=4095, exposure_s=0.1, file="leak.png")])


def test_a_partly_saturated_dark_names_the_frame():
    burnt = frame(100, file="burnt.png").data.copy()
    burnt[:3] = 4095
    with pytest.raises(BadInput, match=r"burnt\.png: .*saturated"):
        measure("dark", [Frame(data=burnt, bit_depth=12, white_level_dn=4095, exposure_s=0.1, file="burnt.png")])


@pytest.mark.parametrize("kind", ["flat", "light"])
def test_a_frame_that_says_it_is_no_dark(kind):
    with pytest.raises(BadInput, match=rf"says that it is a {kind} frame[\s\S]*swapped"):
        measure("dark", [frame(100, kind=kind)])


def test_swapped_folders():
    bright = [frame(2000, seed=i, kind="dark", file=f"bright{i}.png") for i in range(3)]
    dim = [frame(60, seed=9 + i, kind="flat", file=f"dim{i}.png") for i in range(3)]
    with pytest.raises(BadInput, match="swapped"):
        measure("flat", [*bright, *dim])


def test_flats_without_darks_or_darks_without_flats():
    with pytest.raises(BadInput, match="flats need darks"):
        measure("flat", [frame(2000, seed=i) for i in range(3)])
    with pytest.raises(BadInput, match="no flat frames"):
        measure("flat", [frame(60, seed=i, kind="dark") for i in range(3)])


def test_darks_of_another_exposure_cannot_be_scaled_from_one():
    darks = [frame(60, seed=i, kind="dark", exposure_s=1.0) for i in range(3)]
    with pytest.raises(BadInput, match="flats of 0.1 s, but darks of 1 s only"):
        measure("flat", [*darks, *(frame(2000, seed=9 + i) for i in range(3))])


def test_an_exposure_longer_than_a_day_is_a_wrong_unit():
    with pytest.raises(BadInput, match="longer than a day"):
        measure("dark", [frame(100, seed=i, exposure_s=t) for i, t in enumerate((1e6, 1e6, 5e6, 5e6))])


def test_one_frame_without_exposure_is_left_out_where_others_have_one():
    frames = [frame(100, seed=i, exposure_s=t) for i, t in enumerate((0.1, 0.1, 1.0, 1.0))]
    result = measure("dark", [*frames, frame(100, seed=7, exposure_s=None, file="bare.png")])
    assert result.frames_used == 4 and "exposure" in dict(result.frames_rejected)["bare.png"]


def test_a_constant_frame_gives_figures_and_no_nan():
    frames = [Frame(data=np.full(SHAPE, 7 + i, np.uint8), bit_depth=8, white_level_dn=255) for i in range(2)]
    result = measure("dark", frames)
    assert all(np.isfinite(layer).all() for layer in result.maps.values())
    assert all(q.value is None or np.isfinite(q.value) for q in result.quantities)
    assert not result.maps["defects"].any()


def test_one_dark_frame_gives_an_offset_and_says_what_is_missing():
    result = measure("dark", [frame(100)])
    assert np.isfinite(result.maps["offset_dn"]).all() and "read_noise_dn" not in result.maps
    assert "two frames" in result.quantity("read_noise_dn").reason
    assert any("noise unknown" in w for w in result.warnings)


def test_pictures_without_a_board():
    with pytest.raises(BadInput, match="0 of 3 frames can be used"):
        measure("intrinsics", [frame(100, seed=i, file=f"{i}.png") for i in range(3)])


def test_an_averaged_frame_is_no_frame():
    master = Frame(data=np.full(SHAPE, 10.25, np.float32), bit_depth=12, white_level_dn=4095, file="master.fits")
    with pytest.raises(BadInput, match=r"master\.fits: pixel values are no whole DN"):
        measure("dark", [master])
