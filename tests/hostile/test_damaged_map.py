"""Maps that are damaged, foreign or half there are refused; a write that fails leaves the old map as it was."""

from __future__ import annotations

import errno
import io
import os
import resource
import subprocess
import sys

import numpy as np
import pytest
from astropy.io import fits

from calibench.errors import BadInput
from calibench.io import atomic, map_layout
from calibench.io.map_file import encode_map, map_info, read_map, verify_map, write_map
from calibench.records import CalibrationMap, Intrinsics


def a_map(level_dn: float = 64.0) -> CalibrationMap:
    w, h = 64, 48
    rng = np.random.default_rng(3)
    lens = Intrinsics(model="brown4", fx_px=500.0, fy_px=501.0, cx_px=31.5, cy_px=23.5, image_size_px=(w, h),
                      distortion=[-0.1, 0.02, 0.0, 0.0], covariance=np.eye(8))
    return CalibrationMap(
        image_size_px=(w, h), measured=frozenset(["offset_dn", "response", "defects", "intrinsics"]),
        offset_dn=rng.normal(level_dn, 2, (h, w)), response=rng.normal(1, 0.01, (h, w)),
        defects=rng.choice(np.array([0, 2, 4], np.uint16), (h, w)), intrinsics=lens,
        evidence={"intrinsics/corner_xy_px": rng.uniform(0, 40, (5, 2))}, created="2024-01-01T00:00:00Z")


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "calibration.fits"
    write_map(path, a_map())
    return path


def refused(path, *, check: str | None = None) -> str:
    """The message with which the file is refused; verify_map must agree and name the check."""
    with pytest.raises(BadInput) as caught:
        read_map(path)
    assert caught.value.exit_code == 3 and "how to mend" in str(caught.value) and str(path) in str(caught.value)
    failed = [c.name for c in verify_map(path) if not c.ok]
    assert len(failed) == 1 and check in (None, failed[0])
    return str(caught.value)


def sealed(hdus: fits.HDUList) -> bytes:
    """The file of these HDUs with every sum right, as another program (or a later layout) would write it."""
    hdus[0].header["SHA256"] = "0" * 64
    stream = io.BytesIO()
    hdus.writeto(stream, checksum=True)
    primary = fits.HDUList.fromstring(stream.getvalue())[0]
    body = stream.getvalue()[len(primary.header.tostring()):]
    primary.header["FILESIZE"] = len(stream.getvalue())
    primary.header["SHA256"] = map_layout.digest(primary.header.tostring().encode() + body)
    primary.add_checksum(override_datasum=True)
    return primary.header.tostring().encode() + body


@pytest.mark.parametrize("seed", range(40))
def test_one_flipped_bit_anywhere_is_refused(path, seed):
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    path.write_bytes(content)
    refused(path)


def test_every_bit_position_of_the_primary_header_is_guarded(path):
    good = path.read_bytes()
    for at in range(0, map_layout.header_end(good), 7):
        content = bytearray(good)
        content[at] ^= 4
        path.write_bytes(content)
        refused(path)


@pytest.mark.parametrize("fraction", [0.0001, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.7, 0.8, 0.9, 0.99, 0.99999])
def test_a_file_cut_short_is_refused(path, fraction):
    content = path.read_bytes()
    path.write_bytes(content[:int(fraction * len(content))])
    refused(path)


@pytest.mark.parametrize("blocks", [1, 2, 3])
def test_a_file_cut_at_a_block_is_called_cut_short(path, blocks):
    path.write_bytes(path.read_bytes()[:-2880 * blocks])
    assert "cut short" in refused(path, check="length")


def test_bytes_behind_the_end_are_refused(path):
    path.write_bytes(path.read_bytes() + b"\0" * 2880)
    refused(path, check="length")


@pytest.mark.parametrize("distance", [4, 8, 2880])
def test_swapped_words_that_the_fits_sum_misses_are_caught_by_the_sha(path, distance):
    with fits.open(path) as hdus:
        at = hdus["OFFSET_DN"].fileinfo()["datLoc"]
    content = bytearray(path.read_bytes())
    # The same half of two 32-bit words: the ones'-complement sum of all words stays what it was.
    content[at:at + 2], content[at + distance:at + distance + 2] = (
        content[at + distance:at + distance + 2], content[at:at + 2])
    assert bytes(content) != path.read_bytes()
    path.write_bytes(content)
    with fits.open(path) as hdus:
        assert hdus["OFFSET_DN"].verify_datasum() == 1 and hdus["OFFSET_DN"].verify_checksum() == 1
    assert "SHA-256" in refused(path, check="SHA-256")


def test_a_missing_file_a_folder_and_an_empty_file(tmp_path):
    assert "no such file" in refused(tmp_path / "none.fits", check="readable")
    assert "not a file" in refused(tmp_path, check="readable")
    (tmp_path / "empty.fits").touch()
    assert "empty" in refused(tmp_path / "empty.fits", check="a calibench map")


def test_what_is_not_fits_or_not_a_map(tmp_path):
    path = tmp_path / "other"
    path.write_text("camera_matrix: nothing like it\n" * 200)
    assert "not a FITS file" in refused(path, check="a calibench map")
    fits.PrimaryHDU(np.zeros((4, 4))).writeto(tmp_path / "frame.fits", checksum=True)
    assert "no calibench map" in refused(tmp_path / "frame.fits", check="a calibench map")


def test_an_unknown_schema_says_its_version(path):
    with fits.open(path) as hdus:
        hdus[0].header["CBSCHEMA"] = 99
        content = sealed(hdus)
    path.write_bytes(content)
    assert "schema 99" in refused(path, check="schema")


@pytest.mark.parametrize("extension", ["METADATA", "QUANTITIES", "INPUTS", "VERDICTS", "OFFSET_DN", "DEFECTS",
                                       "INTRINSICS_COVARIANCE", "EVIDENCE/INTRINSICS/CORNER_XY_PX"])
def test_a_missing_extension_is_named(path, extension):
    with fits.open(path) as hdus:
        del hdus[extension]
        content = sealed(hdus)
    path.write_bytes(content)
    assert extension in refused(path, check="extensions").upper()


def test_the_helper_that_seals_a_file_makes_a_good_one(path):
    with fits.open(path) as hdus:
        content = sealed(hdus)
    path.write_bytes(content)
    assert read_map(path).measured == a_map().measured


@pytest.mark.parametrize("text", ["{}", "[]", "not json", '{"layers": {"psf": {"measured": true}}, "evidence": 3}'])
def test_metadata_that_is_no_description_is_refused(path, text):
    with fits.open(path) as hdus:
        hdus["METADATA"] = fits.BinTableHDU.from_columns(
            [fits.Column("JSON", format=f"{len(text)}A", array=np.array([text.encode()]))], name="METADATA")
        content = sealed(hdus)
    path.write_bytes(content)
    refused(path)


def test_a_layer_of_another_size_is_refused(path):
    with fits.open(path) as hdus:
        hdus["OFFSET_DN"].data = np.zeros((5, 5), np.float32)
        content = sealed(hdus)
    path.write_bytes(content)
    refused(path)


def test_info_refuses_a_damaged_map_too(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(BadInput):
        map_info(path)


@pytest.mark.parametrize("broken", ["open", "os.fsync", "os.replace"])
def test_a_write_that_fails_leaves_the_old_map(path, monkeypatch, broken):
    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    if broken == "open":
        monkeypatch.setattr(atomic, "open", full, raising=False)
    else:
        monkeypatch.setattr(broken, full)
    before = path.read_bytes()
    with pytest.raises(BadInput, match="No space left on device.*unchanged"):
        write_map(path, a_map(100.0))
    assert path.read_bytes() == before and list(path.parent.iterdir()) == [path]


def test_an_interrupt_leaves_no_temporary_file(path, monkeypatch):
    def interrupt(*_args):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt):
        write_map(path, a_map(100.0))
    assert path.read_bytes() == before and list(path.parent.iterdir()) == [path]


def test_a_disk_that_really_refuses_more_bytes_leaves_the_old_map(path, tmp_path):
    """The kernel itself stops the write in the middle (a limit on the file size), in a process of its own."""
    content = tmp_path / "new.bin"
    content.write_bytes(encode_map(a_map(100.0)))
    before = path.read_bytes()
    script = ("import sys; from pathlib import Path; from calibench.io import atomic\n"
              "from calibench.errors import BadInput\n"
              "try: atomic.write_bytes(sys.argv[1], Path(sys.argv[2]).read_bytes())\n"
              "except BadInput as error: print(error); sys.exit(3)\n")
    limit = len(before) // 2
    run = subprocess.run([sys.executable, "-c", script, str(path), str(content)], capture_output=True, text=True,
                         preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    assert run.returncode == 3 and "File too large" in run.stdout and "unchanged" in run.stdout, run.stderr
    assert path.read_bytes() == before and sorted(path.parent.iterdir()) == sorted([path, content])
    assert read_map(path).measured == a_map().measured


def test_a_missing_folder_is_said(tmp_path):
    with pytest.raises(BadInput, match="nowhere"):
        write_map(tmp_path / "nowhere" / "m.fits", a_map())


def test_a_replaced_file_keeps_its_permissions_and_a_link_stays_a_link(path, tmp_path):
    path.chmod(0o640)
    link = tmp_path / "latest.fits"
    link.symlink_to(path)
    write_map(link, a_map(100.0))
    assert link.is_symlink() and path.stat().st_mode & 0o777 == 0o640
    assert read_map(path).offset_dn.mean() > 90
