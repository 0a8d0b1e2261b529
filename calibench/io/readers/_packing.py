"""Packed pixels: 10 and 12 bits laid end to end.

mipi10, mipi12: MIPI CSI-2 RAW10 and RAW12 (high bytes first, then one byte of low bits).
mono10p, mono12p: GenICam PFNC "p" formats (bits laid from the lowest up, without gaps).
mono12packed: GigE Vision Mono12Packed (two pixels in three bytes, low nibbles in the middle).
"""

from __future__ import annotations

import numpy as np

from ...errors import BadInput

BITS = {"mipi10": 10, "mipi12": 12, "mono10p": 10, "mono12p": 12, "mono12packed": 12}


def unpack(packed: np.ndarray, packing: str, count: int, *, file: object = None) -> np.ndarray:
    """(count,) uint16 of packed bytes (uint8); the pixels must fill whole groups (4 of 10 bits, 2 of 12 bits).

    Raises:
        BadInput: they do not.
    """
    pixels_a_group, bytes_a_group = (4, 5) if BITS[packing] == 10 else (2, 3)
    if count % pixels_a_group:
        raise BadInput(f"{count} pixels do not fill whole groups of {pixels_a_group} ({packing})", file=file,
                       mend="correct width and height in the sidecar")
    b = packed.reshape(-1, bytes_a_group).astype(np.uint16)
    if packing == "mipi10":
        pixels = [b[:, i] << 2 | (b[:, 4] >> 2 * i) & 3 for i in range(4)]
    elif packing == "mipi12":
        pixels = [b[:, i] << 4 | (b[:, 2] >> 4 * i) & 15 for i in range(2)]
    elif packing == "mono10p":
        pixels = [b[:, i] >> 2 * i | (b[:, i + 1] << 8 - 2 * i) & 1023 for i in range(4)]
    elif packing == "mono12p":
        pixels = [b[:, 0] | (b[:, 1] & 15) << 8, b[:, 1] >> 4 | b[:, 2] << 4]
    else:
        pixels = [b[:, 0] << 4 | b[:, 1] & 15, b[:, 2] << 4 | b[:, 1] >> 4]
    return np.stack(pixels, axis=1).ravel()
