"""What is written is read back: pixels and every word about them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibench.errors import BadInput, UsageError
from calibench.io.frame_writer import write_frame
from calibench.io.frames import read_frame

SAID = {"kind": "flat", "exposure_s": 0.0125, "gain_setting": 2.0, "temperature_c": 21.5, "egain_e_per_dn": 7.5,
        "bit_depth": 10, "black_level_dn": 40.0, "white_level_dn": 1000.0, "bayer_pattern": "GBRG", "pixel_size_um": 6.0,
        "date_obs": "2024-05-17T21:04:05", "camera": 'MT9V022 "lab"'}
DATA = np.random.default_rng(5).integers(0, 1024, (30, 44)).astype(np.uint16)


@pytest.mark.parametrize("suffix", [".png", ".fits"])
def test_round_trip(tmp_path: Path, suffix):
    write_frame(tmp_path / f"a{suffix}", DATA, **SAID)
    frame = read_frame(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(frame.data, DATA)
    assert {name: getattr(frame, name) for name in SAID} == SAID
    assert not frame.lossy and not any("ROWORDER" in note for note in frame.notes)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted({f"a{suffix}", "a.png.toml" if suffix == ".png" else "a.fits"})


@pytest.mark.parametrize("suffix", [".png", ".fits"])
def test_numpy_numbers_and_silence(tmp_path: Path, suffix):
    write_frame(tmp_path / f"a{suffix}", DATA, kind="dark", exposure_s=np.float64(0.5))
    frame = read_frame(tmp_path / f"a{suffix}")
    assert (frame.kind, frame.exposure_s, frame.gain_setting, frame.temperature_c) == ("dark", 0.5, None, None)


def test_writing_replaces(tmp_path: Path):
    write_frame(tmp_path / "a.png", DATA, kind="dark", exposure_s=1.0)
    write_frame(tmp_path / "a.png", DATA + 1, kind="dark", exposure_s=2.0)
    assert read_frame(tmp_path / "a.png").exposure_s == 2.0


def test_refusals(tmp_path: Path):
    with pytest.raises(BadInput, match="uint16"):
        write_frame(tmp_path / "a.png", DATA.astype(float), kind="dark", exposure_s=1.0)
    with pytest.raises(UsageError, match="jpg"):
        write_frame(tmp_path / "a.jpg", DATA, kind="dark", exposure_s=1.0)
    with pytest.raises(UsageError, match="sky"):
        write_frame(tmp_path / "a.png", DATA, kind="sky", exposure_s=1.0)
    with pytest.raises(BadInput, match="missing"):
        write_frame(tmp_path / "missing" / "a.png", DATA, kind="dark", exposure_s=1.0)
    assert not list(tmp_path.iterdir())
