"""Reading: what a reader makes of one file, and the checks that all readers share.

A reader is a module of this folder with `SUFFIXES` (lower case, with the dot) and
`read(raw: memoryview, file: Path, sidecar: Sidecar) -> Reading`. The file is read from disk once; the reader decodes its
bytes, and `data` may lie in them.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import BadInput, CalibenchError
from ..metadata import FrameMetadata

MAX_PIXELS = 200_000_000
# No lossless coder of a frame format packs tighter than deflate's limit (RFC 1951: 258 bytes in 2 bits).
MAX_COMPRESSION = 1032
TRUNCATED_MEND = "the file is truncated or damaged: copy it again from the camera, or leave it out"


@dataclass(frozen=True, kw_only=True)
class Reading:
    """data (H, W) as stored, what the file's own header says, and what had to be assumed."""

    data: np.ndarray
    header: FrameMetadata = field(default_factory=FrameMetadata)
    lossy: bool = False
    notes: tuple[str, ...] = ()


class Stream(io.RawIOBase):
    """Bytes in memory as a file to read from; unlike `io.BytesIO` it does not copy them.

    Closed, it lets go of them: tifffile leaves cycles behind, in which twenty frames would wait for the garbage collector.
    """

    def __init__(self, raw: memoryview):
        self._raw, self._at = raw, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = max(0, offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: len(self._raw)}[whence])
        return self._at

    def readinto(self, target: memoryview) -> int:
        part = self._raw[self._at:self._at + len(target)]
        target[:len(part)] = part
        self._at += len(part)
        return len(part)

    def close(self) -> None:
        self._raw = memoryview(b"")
        super().close()


def check_claim(width: int, height: int, *, file: Path, claimed_bytes: int, available_bytes: int,
                compressed: bool = False) -> None:
    """Compare what a header claims with what the file can hold, before anything is allocated.

    Raises:
        BadInput: no pixels, more than MAX_PIXELS, or more bytes than the file can hold.
    """
    if width < 1 or height < 1:
        raise BadInput(f"claims an image of {width} x {height} pixels", file=file, mend=TRUNCATED_MEND)
    if width * height > MAX_PIXELS:
        raise BadInput(f"claims {width} x {height} pixels, more than {MAX_PIXELS // 10**6} megapixels", file=file,
                       mend="a frame of this size is taken for a damaged or hostile file; crop it, or leave it out")
    if claimed_bytes > available_bytes * (MAX_COMPRESSION if compressed else 1):
        raise BadInput(f"claims {width} x {height} pixels ({claimed_bytes} bytes), but holds {available_bytes} bytes of data",
                       file=file, mend=TRUNCATED_MEND)


@contextmanager
def decoding(file: Path, what: str) -> Iterator[None]:
    """Turn whatever a foreign decoder raises on damaged bytes into BadInput.

    Decoders raise nearly every type on hostile input (struct.error, IndexError, TypeError, zlib.error...), so all of
    Exception is caught here, around their calls only.
    """
    try:
        yield
    except CalibenchError:
        raise
    except Exception as error:
        cause = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise BadInput(f"cannot be read as {what}: {cause}", file=file, mend=TRUNCATED_MEND) from error


def luminance(data: np.ndarray, *, file: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    """(H, W) of a picture (H, W) or (H, W, 2..4): the mean of the colours, in the picture's own integer type.

    An alpha channel (the second of two, the fourth of four) is left out.
    """
    if data.ndim == 2:
        return data, ()
    if data.ndim != 3 or data.shape[2] not in (1, 2, 3, 4):
        raise BadInput(f"holds an array of shape {data.shape}; a frame is one image", file=file,
                       mend="save each image as a file of its own")
    colours = data[..., : 3 if data.shape[2] >= 3 else 1]
    notes = ("alpha channel left out",) if data.shape[2] in (2, 4) else ()
    first = colours[..., 0]
    if all(np.array_equal(first, colours[..., i]) for i in range(1, colours.shape[2])):
        return np.ascontiguousarray(first), notes
    mean = colours.mean(axis=2, dtype=np.float32)
    if np.issubdtype(data.dtype, np.integer):
        mean = np.rint(mean).astype(data.dtype)
    return mean, (*notes, "colour picture: the mean of red, green and blue was taken as luminance")


def frame_values(data: np.ndarray, *, file: Path) -> np.ndarray:
    """The pixels as uint8, uint16 or float32, whichever holds them exactly.

    Raises:
        BadInput: not numbers, not finite, or whole numbers that float32 cannot hold.
    """
    if data.dtype in (np.uint8, np.uint16) and data.dtype.isnative:
        return data
    if data.dtype.kind not in "uif":
        raise BadInput(f"holds values of type {data.dtype}, not numbers of a sensor", file=file)
    if data.dtype.kind == "f":
        bad = int(np.count_nonzero(~np.isfinite(data)))
        if bad:
            raise BadInput(f"{bad} pixels are NaN or infinite", file=file, mend="give the frame as the camera wrote it")
        return data.astype(np.float32)
    lowest, largest = int(data.min()), int(data.max())
    if lowest >= 0 and largest < 2**16:
        return data.astype(np.uint8 if data.dtype.itemsize == 1 else np.uint16)
    if max(-lowest, largest) > 2**24:
        raise BadInput(f"values from {lowest} to {largest} are wider than a frame's 24 bits", file=file,
                       mend="give single raw frames, not sums of many")
    return data.astype(np.float32)
