"""Headerless raw: pixels without a word about them. A sidecar must say width, height, dtype or packing, and endianness."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import BadInput, SeveralProblems
from ..metadata import FrameMetadata
from ..sidecar import Sidecar
from ._packing import BITS, unpack
from ._reading import Reading, check_claim, frame_values

SUFFIXES = (".raw", ".bin")
MEND = 'write beside it <file name>.toml with: width = 752, height = 480, dtype = "uint16", endianness = "little"'


def read(raw: memoryview, file: Path, sidecar: Sidecar) -> Reading:
    """The pixels as the sidecar lays them out.

    Raises:
        BadInput: no sidecar, or the file's size is not what the layout claims; SeveralProblems: keys are missing or clash.
    """
    layout, packing = sidecar.layout, sidecar.layout.get("packing", "none")
    if not layout:
        raise BadInput("has no header, and no sidecar says how it is laid out", file=file, mend=MEND)
    problems = [(key, "is missing") for key in ("width", "height") if key not in layout]
    if packing == "none":
        if "dtype" not in layout:
            problems.append(("dtype", "is missing (or a packing)"))
        elif layout["dtype"] != "uint8" and "endianness" not in layout:
            problems.append(("endianness", "is missing: values of several bytes can be read either way"))
    elif layout.get("dtype", "uint16") != "uint16":
        problems.append(("dtype", f"is {layout['dtype']}, but packing {packing} unpacks to uint16"))
    if problems:
        raise SeveralProblems(problems, file=file, mend=f"{MEND} (its sidecar: {sidecar.source})")

    width, height, offset = layout["width"], layout["height"], layout.get("offset_bytes", 0)
    dtype = np.dtype(layout.get("dtype", "uint16"))
    bits = BITS.get(packing, 8 * dtype.itemsize)
    claimed = (width * height * bits + 7) // 8
    check_claim(width, height, file=file, claimed_bytes=claimed, available_bytes=len(raw) - offset)
    if claimed < len(raw) - offset:
        raise BadInput(f"holds {len(raw) - offset - claimed} bytes more than {width} x {height} pixels of {bits} bits",
                       file=file, mend=f"correct width, height, packing or offset_bytes in {sidecar.source}: "
                                       "a wrong width shears the image without a sign")
    if packing == "none":
        pixels = np.frombuffer(raw, dtype.newbyteorder("<" if layout.get("endianness") != "big" else ">"), offset=offset)
        return Reading(data=frame_values(pixels.astype(dtype, copy=False).reshape(height, width), file=file))
    pixels = unpack(np.frombuffer(raw, np.uint8, offset=offset), packing, width * height, file=file)
    return Reading(data=pixels.reshape(height, width), header=FrameMetadata(bit_depth=bits, alignment="right"))
