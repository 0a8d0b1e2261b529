"""npy (NumPy enhancement proposal 1): one (H, W) array. Pickled objects are refused."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ..sidecar import Sidecar
from ._reading import Reading, check_claim, decoding, frame_values

SUFFIXES = (".npy",)


def read(raw: memoryview, file: Path, sidecar: Sidecar) -> Reading:
    """The array of the file.

    Raises:
        BadInput: no npy file, pickled objects, not two-dimensional, or a header that claims more than the file holds.
    """
    stream = io.BytesIO(raw)
    with decoding(file, "npy"):
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
    if dtype.hasobject:
        raise BadInput("holds pickled Python objects, which are never loaded", file=file,
                       mend="save the pixels as an array of uint16")
    if len(shape) != 2:
        raise BadInput(f"holds an array of shape {shape}; a frame is (height, width)", file=file,
                       mend="save each image as a file of its own")
    check_claim(shape[1], shape[0], file=file, claimed_bytes=math.prod(shape) * dtype.itemsize,
                available_bytes=len(raw) - stream.tell())
    with decoding(file, "npy"):
        data = np.load(io.BytesIO(raw), allow_pickle=False)
    return Reading(data=frame_values(data, file=file))
