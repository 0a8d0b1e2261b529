"""JPEG and BMP, 8 bit: enough for boards and for a sky frame, and said to be lossy."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ..metadata import FrameMetadata
from ..sidecar import Sidecar
from ._exif import exif_of
from ._reading import TRUNCATED_MEND, Reading, check_claim, decoding, luminance

SUFFIXES = (".jpg", ".jpeg", ".bmp")
# Start-of-frame markers, ITU-T T.81 table B.1: SOF0..SOF15 without DHT, JPG and DAC.
SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
SOS, EOI, APP1 = 0xDA, 0xD9, 0xE1


def read(raw: memoryview, file: Path, sidecar: Sidecar) -> Reading:
    """The picture on the sensor's own axes (an EXIF orientation is not applied), colours as their mean.

    Raises:
        BadInput: neither JPEG nor BMP, truncated, or a header that claims more than the file can hold.
    """
    import cv2

    raw, header, notes = bytes(raw), FrameMetadata(), ()
    if raw.startswith(b"\xff\xd8"):
        width, height, exif = _walk_jpeg(raw, file)
        # The least a JPEG can spend is one bit for a block of 64 pixels.
        check_claim(width, height, file=file, claimed_bytes=width * height // 512, available_bytes=len(raw))
        header, notes = exif_of(exif) if exif else (header, notes)
    elif raw.startswith(b"BM") and len(raw) >= 30:
        width, height, _, bits, coding = struct.unpack_from("<iiHHI", raw, 18)
        if coding not in (0, 3):
            raise BadInput("is a run-length coded BMP", file=file, mend="save it uncompressed or as PNG")
        check_claim(width, abs(height), file=file, claimed_bytes=(width * bits + 31) // 32 * 4 * abs(height),
                    available_bytes=len(raw) - struct.unpack_from("<I", raw, 10)[0])
    else:
        raise BadInput("is neither a JPEG nor a BMP file", file=file, mend=TRUNCATED_MEND)
    with decoding(file, "a picture"):
        picture = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise BadInput("cannot be decoded as a picture", file=file, mend=TRUNCATED_MEND)
    data, colour_notes = luminance(picture, file=file)
    return Reading(data=data, header=header, lossy=True, notes=(*colour_notes, *notes))


def _walk_jpeg(raw: bytes, file: Path) -> tuple[int, int, bytes]:
    """Width, height and the EXIF block of a JPEG, and the check that its end is there (T.81 annex B)."""
    at, size, exif = 2, None, b""
    while at + 4 <= len(raw) and raw[at] == 0xFF:
        marker, length = raw[at + 1], struct.unpack_from(">H", raw, at + 2)[0]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if marker == SOS:
            # Inside the scans FF is always stuffed, so the end marker cannot appear in them by chance.
            if size is None or raw.find(bytes((0xFF, EOI)), at) < 0:
                break
            return *size, exif
        if marker in SOF and at + 9 <= len(raw):
            height, width = struct.unpack_from(">HH", raw, at + 5)
            size = width, height
        if marker == APP1 and raw[at + 4:at + 10] == b"Exif\0\0":
            exif = raw[at + 10:at + 2 + length]
        at += 2 + length
    raise BadInput(f"ends after {len(raw)} bytes, before the picture does", file=file, mend=TRUNCATED_MEND)
