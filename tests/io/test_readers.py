"""Every reader gives back the pixels that were written, and what the header says about them."""

from __future__ import annotations

import gc
import io
import struct
import weakref
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from astropy.io import fits

from calibench import registry
from calibench.errors import BadInput
from calibench.io.frames import READERS, read_frame
from calibench.io.readers import tiff
from calibench.io.sidecar import sidecar_of

SHAPE = (48, 64)


def twelve_bits(seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(60, 4096, SHAPE).astype(np.uint16)


def exif_directory(order: str, at: int, exposure: tuple[int, int], iso: int) -> bytes:
    """An EXIF directory that stands at byte `at` of a TIFF structure."""
    taken = b"2024:05:17 21:04:05\0"
    data_at = at + 2 + 3 * 12 + 4
    entries = [struct.pack(f"{order}HHII", 0x829A, 5, 1, data_at), struct.pack(f"{order}HHIHH", 0x8827, 3, 1, iso, 0),
               struct.pack(f"{order}HHII", 0x9003, 2, len(taken), data_at + 8)]
    return struct.pack(f"{order}H", 3) + b"".join(entries) + struct.pack(f"{order}III", 0, *exposure) + taken


def exif_block(order: str = "<", exposure: tuple[int, int] = (1, 50), iso: int = 800) -> bytes:
    """A TIFF structure with nothing but an EXIF directory, as JPEG embeds it."""
    head = b"II*\0" if order == "<" else b"MM\0*"
    ifd = struct.pack(f"{order}IHHHIII", 8, 1, 0x8769, 4, 1, 26, 0)
    return head + ifd + exif_directory(order, 26, exposure, iso)


def tiff_with_exif(data: np.ndarray, exposure: tuple[int, int], iso: int, tags: list[tuple], **options: object) -> bytes:
    """A TIFF with an EXIF directory behind its pixels. tifffile writes no EXIF tag: its neighbour is written and renamed."""
    placeholder, exif = struct.pack("<HHI", 0x876A, 4, 1), struct.pack("<HHI", 0x8769, 4, 1)
    stream = io.BytesIO()
    tifffile.imwrite(stream, data, extratags=[*tags, (0x876A, "I", 1, 0, True)], metadata=None, byteorder="<", **options)
    raw = stream.getvalue()
    at = raw.index(placeholder)
    raw = raw[:at] + exif + struct.pack("<I", len(raw)) + raw[at + 12:]
    return raw + exif_directory("<", len(raw), exposure, iso)


def dng_bytes(data: np.ndarray, *, black: int = 64, white: int = 4095, pattern: tuple = (0, 1, 1, 2)) -> bytes:
    """A minimal DNG 1.4 with an EXIF directory behind its pixels."""
    tags = [(50706, "B", 4, bytes([1, 4, 0, 0]), True), (33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes(pattern), True),
            (50708, "s", 0, "Testcam One", True), (50714, "H", 1, black, True), (50717, "H", 1, white, True),
            (50778, "H", 1, 21, True), (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True)]
    return tiff_with_exif(data, (1, 50), 800, tags, photometric=32803)


@pytest.mark.parametrize("name", registry.names(READERS))
def test_every_reader_keeps_the_contract(name):
    reader = registry.load(READERS, name)
    assert callable(reader.read)
    assert reader.__doc__ and reader.read.__doc__
    assert reader.SUFFIXES and all(s.startswith(".") and s == s.lower() for s in reader.SUFFIXES)


def test_no_two_readers_claim_one_suffix():
    claimed = [suffix for name in registry.names(READERS) for suffix in registry.load(READERS, name).SUFFIXES]
    assert len(claimed) == len(set(claimed))


@pytest.mark.parametrize("suffix", [".png", ".tif", ".npy", ".fits", ".fts", ".fz"])
def test_sixteen_bits_survive(tmp_path: Path, suffix):
    data, path = twelve_bits(), tmp_path / f"a{suffix}"
    if suffix == ".png":
        cv2.imwrite(str(path), data)
    elif suffix == ".tif":
        tifffile.imwrite(path, data)
    elif suffix == ".npy":
        np.save(path, data)
    elif suffix == ".fz":
        fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(data, compression_type="RICE_1")]).writeto(path)
    else:
        fits.PrimaryHDU(data).writeto(path)
    frame = read_frame(path)
    assert frame.data.dtype == np.uint16
    np.testing.assert_array_equal(frame.data, data)
    assert (frame.bit_depth, frame.white_level_dn, frame.lossy) == (16, 65535.0, False)
    assert any(str(data.max()) in note for note in frame.notes), "16 assumed bits are said, with the largest value"


@pytest.mark.parametrize("compression", ["zlib", "lzw"])
def test_compressed_tiff(tmp_path: Path, compression):
    pytest.importorskip("imagecodecs")
    data = twelve_bits()
    tifffile.imwrite(tmp_path / "a.tiff", data, compression=compression, predictor=2)
    np.testing.assert_array_equal(read_frame(tmp_path / "a.tiff").data, data)


def test_compression_without_its_package_is_named(tmp_path: Path, monkeypatch):
    pytest.importorskip("imagecodecs")
    tifffile.imwrite(tmp_path / "a.tiff", twelve_bits(), compression="lzw")

    def missing(*_args, **_kwargs):
        raise ValueError("<COMPRESSION.LZW: 5> requires the 'imagecodecs' package")
    monkeypatch.setattr(tifffile.TiffPage, "asarray", missing)
    with pytest.raises(BadInput, match="LZW.*imagecodecs"):
        read_frame(tmp_path / "a.tiff")


def test_tiff_says_its_exif(tmp_path: Path):
    raw = tiff_with_exif(twelve_bits(), (3, 10), 400, [(272, "s", 0, "Testcam", True)])
    (tmp_path / "a.tif").write_bytes(raw)
    frame = read_frame(tmp_path / "a.tif")
    assert (frame.exposure_s, frame.gain_setting, frame.camera) == (0.3, 400.0, "Testcam")


@pytest.mark.parametrize("suffix", [".png", ".bmp"])
def test_eight_bits_stay_eight_bits_and_are_said_to_be_lossy(tmp_path: Path, suffix):
    data = (twelve_bits() >> 4).astype(np.uint8)
    cv2.imwrite(str(tmp_path / f"a{suffix}"), data)
    frame = read_frame(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(frame.data, data)
    assert (frame.data.dtype, frame.bit_depth, frame.white_level_dn, frame.lossy) == (np.uint8, 8, 255.0, True)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_colours_become_their_mean(tmp_path: Path, depth):
    colours = np.zeros((4, 6, 3), depth)
    colours[...] = (30, 60, 91)
    cv2.imwrite(str(tmp_path / "a.png"), colours)
    frame = read_frame(tmp_path / "a.png")
    assert frame.data.dtype == depth and np.all(frame.data == 60)
    assert any("luminance" in note for note in frame.notes)


def test_alpha_is_left_out_of_the_luminance(tmp_path: Path):
    grey = np.full((4, 6, 4), 80, np.uint8)
    grey[..., 3] = 255
    cv2.imwrite(str(tmp_path / "a.png"), grey)
    assert np.all(read_frame(tmp_path / "a.png").data == 80)


@pytest.mark.parametrize("order", ["<", ">"])
def test_jpeg_says_its_exif_and_keeps_its_date_to_itself(tmp_path: Path, order):
    data = np.full((32, 40), 77, np.uint8)
    encoded = cv2.imencode(".jpg", data)[1].tobytes()
    exif = b"Exif\0\0" + exif_block(order)
    (tmp_path / "a.jpg").write_bytes(encoded[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + encoded[2:])
    frame = read_frame(tmp_path / "a.jpg")
    assert (frame.exposure_s, frame.gain_setting, frame.date_obs, frame.lossy) == (0.02, 800.0, None, True)
    assert any("2024:05:17" in note for note in frame.notes)
    np.testing.assert_allclose(frame.data, 77, atol=1)


def test_dng_gives_the_mosaic_with_its_levels(tmp_path: Path):
    data = twelve_bits()
    (tmp_path / "a.dng").write_bytes(dng_bytes(data))
    frame = read_frame(tmp_path / "a.dng")
    np.testing.assert_array_equal(frame.data, data)
    assert (frame.bayer_pattern, frame.black_level_dn, frame.white_level_dn, frame.bit_depth) == ("RGGB", 64.0, 4095.0, 12)
    assert (frame.exposure_s, frame.gain_setting, frame.lossy) == (0.02, 800.0, False)


def test_dng_pattern_follows_the_file(tmp_path: Path):
    (tmp_path / "a.dng").write_bytes(dng_bytes(twelve_bits(), pattern=(1, 2, 0, 1)))
    assert read_frame(tmp_path / "a.dng").bayer_pattern == "GBRG"


def test_fits_keywords(tmp_path: Path):
    header = fits.Header({"EXPTIME": 2.5, "EXPOSURE": 2.5, "GAIN": 139, "EGAIN": 0.24, "CCD-TEMP": -9.8,
                          "IMAGETYP": "DARK frame", "BAYERPAT": "rggb", "DATE-OBS": "2024-05-17T21:04:05.123",
                          "ROWORDER": "TOP-DOWN", "INSTRUME": "ZWO ASI", "XPIXSZ": 3.76})
    fits.PrimaryHDU(twelve_bits(), header).writeto(tmp_path / "a.fits", checksum=True)
    frame = read_frame(tmp_path / "a.fits")
    assert (frame.exposure_s, frame.gain_setting, frame.egain_e_per_dn, frame.temperature_c) == (2.5, 139, 0.24, -9.8)
    assert (frame.kind, frame.bayer_pattern, frame.camera, frame.pixel_size_um) == ("dark", "RGGB", "ZWO ASI", 3.76)
    assert frame.date_obs == "2024-05-17T21:04:05.123"


@pytest.mark.parametrize(("rows", "pattern"), [(48, "GBRG"), (47, "RGGB")])
def test_bottom_up_rows_are_flipped_and_the_pattern_with_them(tmp_path: Path, rows, pattern):
    stored = twelve_bits()[:rows]
    fits.PrimaryHDU(stored, fits.Header({"ROWORDER": "BOTTOM-UP", "BAYERPAT": "RGGB"})).writeto(tmp_path / "a.fits")
    frame = read_frame(tmp_path / "a.fits")
    np.testing.assert_array_equal(frame.data, stored[::-1])
    assert frame.bayer_pattern == pattern
    # The red pixel of the stored first row is still the red pixel of the pattern, wherever its row went.
    row = rows - 1
    assert frame.data[row, 0] == stored[0, 0] and pattern[2 * (row % 2)] == "R"


def test_absent_row_order_takes_rows_as_stored_and_says_so(tmp_path: Path):
    data = twelve_bits()
    fits.PrimaryHDU(data).writeto(tmp_path / "a.fit")
    frame = read_frame(tmp_path / "a.fit")
    np.testing.assert_array_equal(frame.data, data)
    assert any("ROWORDER" in note for note in frame.notes)


def test_bayer_offset_moves_the_pattern(tmp_path: Path):
    fits.PrimaryHDU(twelve_bits(), fits.Header({"BAYERPAT": "RGGB", "XBAYROFF": 1})).writeto(tmp_path / "a.fits")
    assert read_frame(tmp_path / "a.fits").bayer_pattern == "GRBG"


def test_drivers_zeros_are_not_taken_for_values(tmp_path: Path):
    fits.PrimaryHDU(twelve_bits(), fits.Header({"EGAIN": 0.0, "BITDEPTH": 32})).writeto(tmp_path / "a.fits")
    frame = read_frame(tmp_path / "a.fits")
    assert (frame.egain_e_per_dn, frame.bit_depth) == (None, 16)
    assert any("EGAIN 0" in note for note in frame.notes)


def test_signed_and_scaled_fits_become_float(tmp_path: Path):
    fits.PrimaryHDU(np.array([[-3, 5], [7, 70000]], np.int32)).writeto(tmp_path / "a.fits")
    frame = read_frame(tmp_path / "a.fits")
    assert frame.data.dtype == np.float32
    np.testing.assert_array_equal(frame.data, [[-3, 5], [7, 70000]])


@pytest.mark.parametrize("endianness", ["little", "big"])
def test_headerless_pixels_as_the_sidecar_lays_them_out(tmp_path: Path, endianness):
    data = twelve_bits()
    raw = b"HEAD" + data.astype("<u2" if endianness == "little" else ">u2").tobytes()
    (tmp_path / "a.raw").write_bytes(raw)
    (tmp_path / "a.raw.toml").write_text(f'width = 64\nheight = 48\ndtype = "uint16"\nendianness = "{endianness}"\n'
                                         "offset_bytes = 4\nbit_depth = 12\nexposure_s = 0.5\n")
    frame = read_frame(tmp_path / "a.raw")
    np.testing.assert_array_equal(frame.data, data)
    assert (frame.bit_depth, frame.exposure_s) == (12, 0.5)


def packed(data: np.ndarray, packing: str) -> bytes:
    """An independent packer: bit strings, pixel by pixel."""
    values, out = data.ravel().tolist(), bytearray()
    if packing in ("mono10p", "mono12p"):
        bits, total = (10 if packing == "mono10p" else 12), 0
        for i, value in enumerate(values):
            total |= value << bits * i
        return total.to_bytes(len(values) * bits // 8, "little")
    if packing == "mipi10":
        for i in range(0, len(values), 4):
            four = values[i:i + 4]
            out += bytes(v >> 2 for v in four) + bytes([sum((v & 3) << 2 * j for j, v in enumerate(four))])
    for i in range(0, len(values), 2) if packing != "mipi10" else ():
        a, b = values[i], values[i + 1]
        low = (a & 15) | (b & 15) << 4
        out += bytes([a >> 4, b >> 4, low] if packing == "mipi12" else [a >> 4, low, b >> 4])
    return bytes(out)


@pytest.mark.parametrize(("packing", "bits"), [("mipi10", 10), ("mipi12", 12), ("mono10p", 10), ("mono12p", 12),
                                               ("mono12packed", 12)])
def test_packed_pixels(tmp_path: Path, packing, bits):
    data = twelve_bits() >> (12 - bits)
    (tmp_path / "a.bin").write_bytes(packed(data, packing))
    (tmp_path / "a.bin.toml").write_text(f'width = 64\nheight = 48\npacking = "{packing}"\n')
    frame = read_frame(tmp_path / "a.bin")
    np.testing.assert_array_equal(frame.data, data)
    assert (frame.bit_depth, frame.white_level_dn) == (bits, 2.0**bits - 1)


def test_a_tiff_lets_go_of_its_bytes_without_the_garbage_collector(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.ones((40, 50), np.uint16))
    raw = np.frombuffer((tmp_path / "a.tif").read_bytes(), np.uint8).copy()
    gone = weakref.ref(raw)
    gc.disable()
    try:
        tiff.read(memoryview(raw), tmp_path / "a.tif", sidecar_of(tmp_path / "a.tif"))
        del raw
        assert gone() is None
    finally:
        gc.enable()
