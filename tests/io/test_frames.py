"""Finding frames, and settling what several sources say about one."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.io.frame_series import FrameSeries
from calibench.io.frames import find_frames, read_frame
from calibench.io.metadata import FrameMetadata, kind_of


def png(path: Path, data: np.ndarray) -> Path:
    cv2.imwrite(str(path), data)
    return path


def series(paths) -> FrameSeries:
    return FrameSeries(paths, lambda path, sha256: read_frame(path, sha256=sha256))


def noise(seed: int = 1, level: float = 500.0) -> np.ndarray:
    return np.random.default_rng(seed).normal(level, 20, (40, 60)).astype(np.uint16)


def test_a_folder_gives_its_frames_sorted_and_ignores_the_rest(tmp_path: Path):
    for name in ("b.png", "a.PNG", ".hidden.png"):
        png(tmp_path / name, noise())
    for name in ("SOURCE.txt", "truth.csv", "x.corrfits", "frames.toml"):
        (tmp_path / name).write_text("")
    (tmp_path / "sub").mkdir()
    png(tmp_path / "sub" / "c.png", noise())
    assert [f.name for f in find_frames([tmp_path])] == ["a.PNG", "b.png"]


def test_a_frame_named_twice_is_found_once(tmp_path: Path):
    path = png(tmp_path / "a.png", noise())
    assert find_frames([path, tmp_path, tmp_path / ".." / tmp_path.name / "a.png"]) == (path,)


@pytest.mark.parametrize("name", ["missing.png", "missing_folder", "notes.txt", "empty_folder"])
def test_what_is_named_must_be_frames(tmp_path: Path, name):
    (tmp_path / "notes.txt").write_text("text")
    (tmp_path / "empty_folder").mkdir()
    with pytest.raises(BadInput) as error:
        find_frames([tmp_path / name])
    assert name in str(error.value) and "how to mend" in str(error.value)


def test_no_argument_is_no_frame():
    with pytest.raises(BadInput, match="no frames"):
        find_frames([])


def test_hash_is_of_the_file(tmp_path: Path):
    path = png(tmp_path / "a.png", noise())
    assert read_frame(path).sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_command_decides_the_kind_only_where_no_source_does(tmp_path: Path):
    path = png(tmp_path / "a.png", noise())
    assert read_frame(path).kind == "unknown"
    assert read_frame(path, "flat").kind == "flat"
    (tmp_path / "a.png.toml").write_text('kind = "dark"\n')
    assert read_frame(path, "flat").kind == "dark"


@pytest.mark.parametrize(("text", "kind"), [("Dark Frame", "dark"), ("DARK", "dark"), ("Bias", "dark"), ("flat", "flat"),
                                            ("Dark Flat", "dark"), ("LIGHT FRAME", "light"), ("Focus", None)])
def test_kind_texts(text, kind):
    assert kind_of(text) == kind


def test_protocol_fills_gaps(tmp_path: Path):
    frame = read_frame(png(tmp_path / "a.png", noise()), protocol=FrameMetadata(exposure_s=0.1, gain_setting=3.0))
    assert (frame.exposure_s, frame.gain_setting) == (0.1, 3.0)


def test_every_contradiction_is_named_with_both_sources(tmp_path: Path):
    path = png(tmp_path / "a.png", noise())
    (tmp_path / "a.png.toml").write_text("exposure_s = 0.1\ngain_setting = 2\n")
    with pytest.raises(BadInput) as error:
        read_frame(path, protocol=FrameMetadata(exposure_s=0.2, gain_setting=4.0))
    message = str(error.value)
    assert "contradict each other" in message
    assert "exposure_s: a.png.toml says 0.1, the protocol says 0.2" in message
    assert "gain_setting: a.png.toml says 2, the protocol says 4.0" in message


def test_rounded_statements_agree(tmp_path: Path):
    path = png(tmp_path / "a.png", noise())
    (tmp_path / "a.png.toml").write_text('exposure_s = 0.0333333\ndate_obs = "2024-05-17T21:04:05Z"\ncamera = "X1"\n')
    protocol = FrameMetadata(exposure_s=0.03333, date_obs="2024-05-17T21:04:05.000", camera="x1")
    assert read_frame(path, protocol=protocol).exposure_s == 0.0333333


def test_white_level_follows_the_bit_depth_unless_stated(tmp_path: Path):
    path = png(tmp_path / "a.png", noise())
    (tmp_path / "a.png.toml").write_text("bit_depth = 10\n")
    assert (read_frame(path).bit_depth, read_frame(path).white_level_dn) == (10, 1023.0)
    (tmp_path / "a.png.toml").write_text("bit_depth = 10\nwhite_level_dn = 1000\n")
    os.utime(tmp_path / "a.png.toml", ns=(1, 1))
    assert read_frame(path).white_level_dn == 1000.0


def test_left_aligned_twelve_bits_are_recognised_on_real_frames(real: Path):
    frames = list(series(find_frames([real / "stars" / "esa_tetra3"])))
    assert len(frames) == 8
    for frame in frames:
        assert (frame.bit_depth, frame.white_level_dn, frame.data.dtype) == (12, 4095.0, np.uint16)
        assert frame.data.max() <= 4095 and "left-aligned" in " ".join(frame.notes)


def test_real_folders_read(real: Path):
    for folder, count in (("boards/opencv", 13), ("stars/creusot_16mm", 20), ("stars/creusot_dark", 15)):
        frames = list(series(find_frames([real / folder])))
        assert len(frames) == count and all(f.bit_depth == 8 and f.lossy for f in frames)
    emva = list(series(find_frames([real / "sensor" / "emva_ccd12_001" / "images"])[:20]))
    assert {(f.bit_depth, f.image_size_px, f.lossy) for f in emva} == {(12, (256, 192), False)}  # as its values show
