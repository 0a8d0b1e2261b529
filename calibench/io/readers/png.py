"""PNG, 8 and 16 bit (ISO/IEC 15948). The header and the chain of chunks are checked before a pixel is decoded."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ..sidecar import Sidecar
from ._reading import TRUNCATED_MEND, Reading, check_claim, decoding, luminance

SUFFIXES = (".png",)
SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type, table 11.1


def read(raw: memoryview, file: Path, sidecar: Sidecar) -> Reading:
    """The picture as stored, colours as their mean.

    Raises:
        BadInput: no PNG, truncated, a damaged chunk, or a header that claims more than the file can hold.
    """
    import cv2

    raw = bytes(raw)
    width, height, bits, colour = _header(raw, file)
    check_claim(width, height, file=file, claimed_bytes=width * height * bits * CHANNELS[colour] // 8,
                available_bytes=len(raw), compressed=True)
    _check_chunks(raw, file)
    with decoding(file, "PNG"):
        picture = cv2.imdecode(np.frombuffer(raw, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise BadInput("cannot be decoded as PNG", file=file, mend=TRUNCATED_MEND)
    data, notes = luminance(picture, file=file)
    return Reading(data=data, notes=notes)


def _header(raw: bytes, file: Path) -> tuple[int, int, int, int]:
    if not raw.startswith(SIGNATURE) or raw[12:16] != b"IHDR" or len(raw) < 33:
        raise BadInput("is no PNG file: its first bytes are not those of the format", file=file, mend=TRUNCATED_MEND)
    width, height, bits, colour = struct.unpack(">IIBB", raw[16:26])
    if colour not in CHANNELS or bits not in (1, 2, 4, 8, 16):
        raise BadInput(f"its header claims colour type {colour} at {bits} bits, which PNG does not know", file=file,
                       mend=TRUNCATED_MEND)
    return width, height, bits, colour


def _check_chunks(raw: bytes, file: Path) -> None:
    """Walk the chunks to IEND: decoders fill what is missing with black and say nothing."""
    view, at = memoryview(raw), len(SIGNATURE)
    while at + 12 <= len(raw):
        length, name = struct.unpack_from(">I4s", raw, at)
        end = at + 12 + length
        if end > len(raw):
            break
        if zlib.crc32(view[at + 4:end - 4]) != struct.unpack_from(">I", raw, end - 4)[0]:
            raise BadInput(f"the checksum of its {name.decode('ascii', 'replace')} chunk does not hold", file=file,
                           mend=TRUNCATED_MEND)
        if name == b"IEND":
            return
        at = end
    raise BadInput(f"ends after {len(raw)} bytes, before the picture does", file=file, mend=TRUNCATED_MEND)
