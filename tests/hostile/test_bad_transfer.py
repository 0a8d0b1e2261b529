"""Photon transfer series that must not become a datasheet, each refused or said with the reason."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.errors import BadInput, SeveralProblems
from calibench.io.descriptor import read_descriptor
from calibench.io.frame_writer import write_frame
from calibench.measure import transfer
from calibench.records import Frame


def test_one_frame_a_level_is_refused_with_how_to_mend(light_ladder):
    frames = [f for f in light_ladder(1, levels=10, stack=0) if f.file.endswith("_00")]
    with pytest.raises(BadInput, match="one frame only") as caught:
        transfer.measure(frames)
    assert "two frames each" in str(caught.value)


def test_a_single_frame_among_pairs_is_left_out_by_name(light_ladder):
    frames = list(light_ladder(1, levels=12, stack=0))
    measured = transfer.measure(frames[1:])
    assert [file for file, _ in measured.frames_rejected] == ["flat_00_01"]
    assert "temporal noise needs two" in measured.frames_rejected[0][1]


def test_too_few_levels(light_ladder):
    with pytest.raises(BadInput, match="light levels lie below 70 %"):
        transfer.measure(light_ladder(2, levels=3, stack=0))
    few = transfer.measure(light_ladder(2, levels=9, stack=0))
    assert any("wants 9 at least" in w for w in few.warnings)


def test_a_ladder_in_too_much_light_is_told_how_much_would_be_right(light_ladder):
    frames = (dataclasses.replace(f, photons_per_px=None) for f in light_ladder(2, levels=10, stack=0, reach=4.0))
    with pytest.raises(BadInput, match="0.0036 s would be right|0.0035 s would be right"):
        transfer.measure(frames)


def test_swapped_folders(light_ladder):
    swap = {"flat": "dark", "dark": "flat"}
    with pytest.raises(BadInput, match="dark"):
        transfer.measure(dataclasses.replace(f, kind=swap[f.kind], photons_per_px=None) for f in light_ladder(3, stack=0))


def test_swapped_dim_levels_are_seen_without_the_look_at_one_frame(light_ladder):
    swap = {"flat": "dark", "dark": "flat"}
    frames = [dataclasses.replace(f, kind=swap[f.kind]) for f in light_ladder(3, stack=0, reach=0.05)]
    with pytest.raises(BadInput, match="darks are brighter"):
        transfer.measure(frames)


def test_only_darks_and_only_light(light_ladder):
    frames = list(light_ladder(4, levels=6, stack=0))
    with pytest.raises(BadInput, match="no level of light"):
        transfer.measure(f for f in frames if f.kind == "dark")
    with pytest.raises(BadInput, match="no darks"):
        transfer.measure(f for f in frames if f.kind == "flat")
    with pytest.raises(BadInput, match="no frames"):
        transfer.measure([])


def test_a_wrong_unit_of_time_is_an_error_and_no_figure(light_ladder):
    def scaled(factor):
        return (dataclasses.replace(f, exposure_s=f.exposure_s * factor) for f in light_ladder(5, stack=0, rate_e_per_s=300.0))
    with pytest.raises(BadInput, match="absurd"):
        transfer.measure(scaled(1e-6))
    with pytest.raises(BadInput, match="longer than a day"):
        transfer.measure(scaled(1e9))


def test_a_light_that_flickers_is_refused_where_its_light_counts(light_ladder):
    with pytest.raises(BadInput, match="flickers"):
        transfer.measure(light_ladder(11, flicker=0.06))
    measured = transfer.measure(light_ladder(11, flicker=0.01))
    assert any("the lamp flickers" in w for w in measured.warnings)
    gain = measured.quantity("gain_dn_per_e")
    assert abs(gain.value - 0.25) < 3 * gain.uncertainty
    with pytest.raises(BadInput, match="a light that flickers looks like that"):
        transfer.measure(dataclasses.replace(f, photons_per_px=None) for f in light_ladder(11, flicker=0.06))


def test_mixed_gains_and_sizes_are_refused(light_ladder):
    frames = list(light_ladder(6, levels=6, stack=0))
    with pytest.raises(BadInput, match="gain_setting"):
        transfer.measure([*frames, dataclasses.replace(frames[3], gain_setting=2.0)])
    with pytest.raises(BadInput, match="image_size_px"):
        transfer.measure([*frames, dataclasses.replace(frames[3], data=frames[3].data[:-2])])


def test_averaged_frames_are_refused(light_ladder):
    with pytest.raises(BadInput, match="no whole DN"):
        transfer.measure(dataclasses.replace(f, data=f.data + np.float32(0.5)) for f in light_ladder(7, levels=6, stack=0))


def test_copies_of_one_frame_are_no_pair(light_ladder):
    frames = [f for f in light_ladder(8, levels=10, stack=0, reach=0.8) if f.file.endswith("_00")]
    with pytest.raises(BadInput, match="one frame only"):
        transfer.measure(f for frame in frames for f in (frame, dataclasses.replace(frame, file=frame.file + "_copy")))


def test_light_that_does_not_grow_noisier_is_refused(light_ladder):
    smooth = np.random.default_rng(9)
    def processed():
        for f in light_ladder(9, levels=12, stack=0):
            data = np.rint(f.data.mean() + smooth.standard_normal(f.data.shape)).clip(0, 4095).astype(np.uint16)
            yield dataclasses.replace(f, data=data)
    with pytest.raises(BadInput, match="does not grow with the light"):
        transfer.measure(processed())


def test_eight_bits_are_said(light_ladder):
    measured = transfer.measure(light_ladder(10, bits=8, gain=0.0156, offset_dn=4.0, stack=0))
    assert any("8-bit" in w for w in measured.warnings)


def test_a_camera_that_gives_constant_frames(light_ladder):
    flat = [Frame(data=np.full((20, 30), 60 + 10 * i, np.uint16), kind="flat", bit_depth=12, white_level_dn=4095,
                  exposure_s=0.01 * (i + 1), sha256=f"{i}{j}") for i in range(10) for j in range(2)]
    dark = [dataclasses.replace(f, kind="dark", data=np.full((20, 30), 50, np.uint16), sha256=f"d{f.sha256}") for f in flat]
    with pytest.raises(BadInput):
        transfer.measure([*flat, *dark])


def test_every_wrong_line_of_a_descriptor_is_named_at_once(tmp_path):
    (tmp_path / "a.png").write_bytes(b"x")
    text = "# note\nv 4.0\ni a.png\nn 12 640\nb ten 5\nb 1000000 5\ni gone.png\ni ../a.png\nq what\nd\n"
    (tmp_path / "series.txt").write_text(text)
    with pytest.raises(SeveralProblems) as caught:
        read_descriptor(tmp_path / "series.txt")
    places = [where for where, _ in caught.value.problems]
    assert places == ["line n", "line 3", "line 4", "line 5", "line 7", "line 8", "line 9", "line 10"]
    said = str(caught.value)
    assert "no file gone.png" in said and "n bits width height" in said and "folder or below" in said


@pytest.mark.parametrize("exposure", ["0.02", "200000000000000"])
def test_a_descriptor_in_other_units_than_nanoseconds_is_refused(tmp_path, exposure):
    (tmp_path / "a.png").write_bytes(b"x")
    (tmp_path / "series.txt").write_text(f"n 12 4 3\nb {exposure} 5\ni a.png\n")
    with pytest.raises(BadInput, match="nanoseconds"):
        read_descriptor(tmp_path / "series.txt")


def test_a_descriptor_that_is_none(tmp_path):
    with pytest.raises(BadInput, match="cannot be read"):
        read_descriptor(tmp_path / "missing.txt")
    (tmp_path / "image.txt").write_bytes(bytes(range(200, 256)))
    with pytest.raises(BadInput, match="no text file"):
        read_descriptor(tmp_path / "image.txt")
    (tmp_path / "empty.txt").write_text("")
    with pytest.raises(BadInput, match="line n"):
        read_descriptor(tmp_path / "empty.txt")


def test_an_image_that_contradicts_the_descriptor(tmp_path):
    from calibench.io.descriptor import described_frames
    write_frame(tmp_path / "a.png", np.zeros((3, 4), np.uint16), kind="dark", exposure_s=0.02, bit_depth=12)
    (tmp_path / "size.txt").write_text("n 12 5 3\nd 20000000\ni a.png\n")
    with pytest.raises(BadInput, match="4 x 3 px"):
        list(described_frames(read_descriptor(tmp_path / "size.txt")))
    (tmp_path / "time.txt").write_text("n 12 4 3\nd 30000000\ni a.png\n")
    with pytest.raises(BadInput, match="exposure_s"):
        list(described_frames(read_descriptor(tmp_path / "time.txt")))
