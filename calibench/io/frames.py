"""Frames from disk: find the files, read each once, and settle what is known about it.

1. The bytes are read once: they are hashed and decoded from memory.
2. The reader of the file's suffix checks what the header claims, then decodes (`readers/`).
3. Header, sidecar and protocol are merged; a contradiction is an error.
4. Left-aligned data are shifted right; bit depth and white level are settled.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from .. import registry
from ..errors import BadInput, Contradiction
from ..records import Frame
from .alignment import right_aligned
from .file_bytes import file_bytes
from .metadata import FrameMetadata, merge
from .readers._reading import Reading
from .sidecar import sidecar_of

READERS = "calibench.io.readers"


@cache
def reader_of_suffix() -> dict[str, str]:
    """File suffix (lower case, with the dot) -> name of the reader that claims it."""
    return {suffix: name for name in registry.names(READERS) for suffix in registry.load(READERS, name).SUFFIXES}


def find_frames(arguments: Sequence[Path]) -> tuple[Path, ...]:
    """The frame files meant by files and folders: sorted, each once.

    Of a folder (not its subfolders) the files that a reader claims are taken and the others ignored; a file named
    outright must be one that a reader claims.

    Raises:
        BadInput: nothing named, a path that does not exist, a folder without frames, a file that no reader claims.
    """
    if not arguments:
        raise BadInput("no frames were named", mend="name frame files, or a folder of them")
    found: dict[Path, Path] = {}
    for path in map(Path, arguments):
        if path.is_dir():
            files = [file for file in _listed(path) if _claimed(file) and file.is_file()]
            if not files:
                raise BadInput("no frame is in this folder", file=path, mend=f"files read are: {_known_suffixes()}")
        elif not path.exists():
            raise BadInput("does not exist", file=path, mend="check the path (a pattern with * that matched nothing?)")
        elif not _claimed(path):
            raise BadInput("no reader knows this kind of file", file=path, mend=f"files read are: {_known_suffixes()}")
        else:
            files = [path]
        found |= {file.resolve(): file for file in files if file.resolve() not in found}
    return tuple(sorted(found.values()))


def read_frame(path: Path, kind: str | None = None, *, protocol: FrameMetadata | None = None, sha256: str = "") -> Frame:
    """One frame with everything that its file, its sidecar and the protocol say.

    kind: what the command supposes where no source says it. protocol: what the session's protocol states; it may
    fill gaps and must not contradict. sha256: of the file, where it was read before: hashing takes most of the time.

    Raises:
        BadInput: the file is missing, empty, truncated or not readable, claims more than it holds, or its sources
            contradict each other.
    """
    path = Path(path)
    raw = file_bytes(path)
    sidecar = sidecar_of(path)
    reading = registry.load(READERS, _reader_name(path)).read(raw, path, sidecar)
    if reading.data.size == 0:
        raise BadInput("holds no pixels", file=path)
    known = merge([("the file's header", reading.header), (sidecar.source, sidecar.metadata),
                   ("the protocol", protocol or FrameMetadata())], file=path)
    if known.exposure_s is not None and known.exposure_s < 0:
        raise BadInput(f"the stated exposure is {known.exposure_s:g} s", file=path, mend="correct the exposure")
    settled = _settled_values(reading, known, path)
    said = {name: value for name, value in vars(known).items() if name != "alignment"}
    return Frame(**(said | settled | {"kind": known.kind or kind or "unknown", "file": str(path),
                                      "sha256": sha256 or hashlib.sha256(raw).hexdigest()}))


def _listed(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError as error:
        raise BadInput(f"cannot be listed: {error.strerror or error}", file=folder, mend="check the rights") from error


def _settled_values(reading: Reading, known: FrameMetadata, path: Path) -> dict[str, object]:
    """Pixels right-aligned, their bit depth and white level, and what had to be assumed for them."""
    data, depth, notes, lossy = reading.data, known.bit_depth, reading.notes, reading.lossy
    if data.dtype == np.uint16:
        data, depth, said = right_aligned(data, bit_depth=depth, alignment=known.alignment, file=path)
        notes = (*notes, said) if said else notes
    elif data.dtype == np.uint8 and depth is None:
        depth, lossy, notes = 8, True, (*notes, "8-bit file: steps of a finer converter may be lost")
    elif data.dtype == np.uint8 and depth > 8:
        raise Contradiction(f"holds 8 bits a pixel, but {depth} bits are stated", file=path,
                       mend="correct bit_depth, or give the frame as a 16-bit file")
    elif depth is None:
        depth, notes = 16, (*notes, "float data: a white level of 16 bits is assumed unless bit_depth is stated")
    white_dn = float(2**depth - 1) if known.white_level_dn is None else known.white_level_dn
    if white_dn > 2**depth and data.dtype != np.float32:
        raise BadInput(f"the stated white level {white_dn:g} DN does not fit {depth}-bit values", file=path,
                       mend="state bit_depth and white_level_dn (right-aligned) in a sidecar")
    assumed = known.bit_depth is None and known.white_level_dn is None and depth == 16
    return {"data": data, "bit_depth": depth, "white_level_dn": white_dn, "notes": notes, "lossy": lossy,
            "range_assumed": assumed}


def _claimed(path: Path) -> bool:
    return path.suffix.lower() in reader_of_suffix() and not path.name.startswith(".")


def _known_suffixes() -> str:
    return " ".join(sorted(reader_of_suffix()))


def _reader_name(path: Path) -> str:
    name = reader_of_suffix().get(path.suffix.lower())
    if name is None:
        raise BadInput("no reader knows this kind of file", file=path, mend=f"files read are: {_known_suffixes()}")
    return name

