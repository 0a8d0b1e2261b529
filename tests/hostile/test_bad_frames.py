"""Damaged, empty, lying and hostile frame files: each is one BadInput that names the file, before memory is taken."""

from __future__ import annotations

import io
import pickle
import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from astropy.io import fits

from calibench.errors import BadInput
from calibench.io.frames import read_frame, reader_of_suffix

DATA = np.random.default_rng(2).integers(60, 4096, (48, 64)).astype(np.uint16)
HUGE = 200_000


def encoded(suffix: str) -> bytes:
    stream = io.BytesIO()
    if suffix in (".png", ".jpg", ".bmp"):
        return cv2.imencode(suffix, DATA if suffix == ".png" else (DATA >> 4).astype(np.uint8))[1].tobytes()
    if suffix == ".tif":
        tifffile.imwrite(stream, DATA)
    elif suffix == ".npy":
        np.save(stream, DATA)
    elif suffix == ".fz":
        fits.HDUList([fits.PrimaryHDU(), fits.CompImageHDU(DATA, compression_type="RICE_1")]).writeto(stream)
    else:
        fits.PrimaryHDU(DATA).writeto(stream)
    return stream.getvalue()


def png_claiming(width: int, height: int) -> bytes:
    def chunk(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
    header = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(1000)))
            + chunk(b"IEND", b""))


def claiming_huge(suffix: str) -> bytes:
    raw = encoded(suffix)
    if suffix == ".png":
        return png_claiming(HUGE, HUGE)
    if suffix == ".npy":
        return raw.replace(b"(48, 64), }" + b" " * 10, b"(200000, 200000), }  ")
    if suffix == ".fits":
        cards = (b"NAXIS1  =                   64", b"NAXIS2  =                   48")
        return raw.replace(cards[0], cards[0][:-6] + b"200000").replace(cards[1], cards[1][:-6] + b"200000")
    if suffix == ".bmp":
        return raw[:18] + struct.pack("<ii", HUGE, HUGE) + raw[26:]
    if suffix == ".jpg":
        at = raw.index(b"\xff\xc0")
        return raw[:at + 5] + struct.pack(">HH", 65500, 65500) + raw[at + 9:]
    with tifffile.TiffFile(io.BytesIO(raw)) as tiff:
        places = [tiff.pages[0].tags[name].offset for name in ("ImageWidth", "ImageLength")]
    changed = bytearray(raw)
    for place in places:
        struct.pack_into("<HHII", changed, place, *struct.unpack_from("<H", changed, place), 4, 1, HUGE)
    return bytes(changed)


def refusal(path: Path) -> str:
    with pytest.raises(BadInput) as error:
        read_frame(path)
    assert path.name in str(error.value)
    assert "Traceback" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("suffix", sorted(reader_of_suffix()))
@pytest.mark.parametrize("content", [b"", b"\0", b"no image at all, but some text\n" * 20, bytes(5000)],
                         ids=["empty", "one byte", "text", "zeros"])
def test_junk_in_every_suffix(tmp_path: Path, suffix, content):
    path = tmp_path / f"junk{suffix}"
    path.write_bytes(content)
    refusal(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".npy", ".fits", ".fz"])
@pytest.mark.parametrize("kept", [0.02, 0.35, 0.7, 0.95])
def test_truncated(tmp_path: Path, suffix, kept):
    raw = encoded(suffix)
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(raw)
    read_frame(path)
    # A FITS file may lack the filling of its last block: what is cut here is always data.
    used = len(raw) - 2880 if suffix == ".fz" else 2880 + DATA.nbytes if suffix == ".fits" else len(raw)
    path.write_bytes(raw[: int(used * kept)])
    assert "how to mend" in refusal(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_missing_end_is_seen_before_decoding(tmp_path: Path, suffix):
    path = tmp_path / f"cut{suffix}"
    path.write_bytes(encoded(suffix)[:-20])
    assert "before the picture does" in refusal(path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".npy", ".fits"])
def test_claims_beyond_the_file_take_no_memory(tmp_path: Path, suffix, monkeypatch):
    path = tmp_path / f"bomb{suffix}"
    path.write_bytes(claiming_huge(suffix))
    (tmp_path / f"good{suffix}").write_bytes(encoded(suffix))
    read_frame(tmp_path / f"good{suffix}")  # the decoder's own imports do not count
    # OpenCV takes its memory unseen by tracemalloc: it must not be asked at all.
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded before the claim was checked"))
    tracemalloc.start()
    assert "claims" in refusal(path) or suffix == ".fits"  # astropy itself sees that the file is too short
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 20e6


def test_png_bomb_within_the_deflate_limit_is_capped(tmp_path: Path):
    path = tmp_path / "bomb.png"
    path.write_bytes(png_claiming(30_000, 30_000) + bytes(2_000_000))
    assert "megapixels" in refusal(path)


def test_a_flipped_bit_in_a_png_is_seen(tmp_path: Path):
    raw = bytearray(encoded(".png"))
    raw[len(raw) // 2] ^= 4
    (tmp_path / "a.png").write_bytes(raw)
    assert "checksum" in refusal(tmp_path / "a.png")


def test_a_flipped_bit_in_a_fits_with_checksum_is_seen(tmp_path: Path):
    stream = io.BytesIO()
    fits.PrimaryHDU(DATA).writeto(stream, checksum=True)
    raw = bytearray(stream.getvalue())
    raw[2880 + 100] ^= 4
    (tmp_path / "a.fits").write_bytes(raw)
    assert "hecksum" in refusal(tmp_path / "a.fits")


def test_pickled_objects_are_never_loaded(tmp_path: Path):
    np.save(tmp_path / "a.npy", np.array([[{"a": 1}]], dtype=object), allow_pickle=True)
    assert "pickled" in refusal(tmp_path / "a.npy")
    (tmp_path / "b.npy").write_bytes(pickle.dumps([1, 2]))
    refusal(tmp_path / "b.npy")


@pytest.mark.parametrize("shape", [(5,), (3, 4, 5), (0, 7)])
def test_npy_of_another_shape(tmp_path: Path, shape):
    np.save(tmp_path / "a.npy", np.zeros(shape, np.uint16))
    refusal(tmp_path / "a.npy")


def test_not_finite_pixels_are_refused(tmp_path: Path):
    np.save(tmp_path / "a.npy", np.array([[1.0, np.nan], [np.inf, 2.0]]))
    assert "2 pixels are NaN" in refusal(tmp_path / "a.npy")


def test_fits_without_an_image_and_with_three_planes(tmp_path: Path):
    fits.PrimaryHDU().writeto(tmp_path / "none.fits")
    assert "no image" in refusal(tmp_path / "none.fits")
    fits.PrimaryHDU(np.zeros((3, 5, 6), np.uint16)).writeto(tmp_path / "cube.fits")
    assert "6 x 5 x 3" in refusal(tmp_path / "cube.fits")


@pytest.mark.parametrize(("keywords", "said"), [({"EXPTIME": 1.0, "EXPOSURE": 2.0}, "EXPOSURE says 2"),
                                                ({"EXPTIME": "long"}, "EXPTIME"), ({"BAYERPAT": "RGBW"}, "BAYERPAT"),
                                                ({"ROWORDER": "SIDEWAYS"}, "ROWORDER")])
def test_fits_keywords_that_mean_nothing(tmp_path: Path, keywords, said):
    fits.PrimaryHDU(DATA, fits.Header(keywords)).writeto(tmp_path / "a.fits")
    assert said in refusal(tmp_path / "a.fits")


def test_a_file_of_several_images_is_no_frame(tmp_path: Path):
    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(DATA), fits.ImageHDU(DATA)]).writeto(tmp_path / "map.fits")
    assert "holds 2 images" in refusal(tmp_path / "map.fits")


@pytest.mark.parametrize(("sidecar", "said"), [("bit_depth = 10\n", "do not fit"), ("exposure_s = -1\n", "exposure_s"),
                                               ("bit_depth = 12\nwhite_level_dn = 9000\n", "white level")])
def test_statements_that_the_pixels_contradict(tmp_path: Path, sidecar, said):
    cv2.imwrite(str(tmp_path / "a.png"), DATA)
    (tmp_path / "a.png.toml").write_text(sidecar)
    with pytest.raises(BadInput, match=said):
        read_frame(tmp_path / "a.png")


def test_eight_bits_cannot_hold_twelve(tmp_path: Path):
    cv2.imwrite(str(tmp_path / "a.png"), (DATA >> 4).astype(np.uint8))
    (tmp_path / "a.png.toml").write_text("bit_depth = 12\n")
    assert "12 bits are stated" in refusal(tmp_path / "a.png")


def test_header_against_sidecar(tmp_path: Path):
    fits.PrimaryHDU(DATA, fits.Header({"EXPTIME": 1.0})).writeto(tmp_path / "a.fits")
    (tmp_path / "a.fits.toml").write_text("exposure_s = 2.0\n")
    assert "the file's header says 1.0, a.fits.toml says 2.0" in refusal(tmp_path / "a.fits")


def test_tiff_stack_is_refused(tmp_path: Path):
    tifffile.imwrite(tmp_path / "a.tif", np.stack([DATA, DATA]), photometric="minisblack")
    assert "2 images" in refusal(tmp_path / "a.tif")


@pytest.mark.parametrize(("sidecar", "said"), [
    (None, "no sidecar"), ("width = 64\n", "height: is missing"), ('width = 64\nheight = 48\ndtype = "uint16"\n', "endianness"),
    ('width = 64\nheight = 49\ndtype = "uint16"\nendianness = "little"\n', "claims 64 x 49"),
    ('width = 63\nheight = 48\ndtype = "uint16"\nendianness = "little"\n', "bytes more"),
    ('width = 64\nheight = 48\npacking = "mipi12"\n', "bytes more"),
    ('width = 64\nheight = 48\npacking = "mipi12"\ndtype = "uint8"\n', "unpacks to uint16")])
def test_headerless_layouts_that_do_not_fit(tmp_path: Path, sidecar, said):
    (tmp_path / "a.raw").write_bytes(DATA.tobytes())
    if sidecar:
        (tmp_path / "a.raw.toml").write_text(sidecar)
    assert said in refusal(tmp_path / "a.raw")


def test_a_missing_file_and_a_folder(tmp_path: Path):
    assert "cannot be opened" in refusal(tmp_path / "none.png")
    (tmp_path / "folder.png").mkdir()
    assert "cannot be opened" in refusal(tmp_path / "folder.png")


def test_seeded_damage_never_escapes_as_another_error(tmp_path: Path):
    random = np.random.default_rng(11)
    for suffix in (".png", ".jpg", ".bmp", ".tif", ".npy", ".fits", ".fz"):
        good = encoded(suffix)
        for trial in range(25):
            raw = bytearray(good)
            for at in random.integers(0, min(len(raw), 4000), 6):
                raw[at] = random.integers(0, 256)
            path = tmp_path / f"{trial}{suffix}"
            path.write_bytes(raw)
            try:
                frame = read_frame(path)
            except BadInput as error:
                assert path.name in str(error)
            else:
                assert frame.data.ndim == 2
