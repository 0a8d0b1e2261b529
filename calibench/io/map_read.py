"""Reading and verifying the map file (layout in map_layout). One inspection serves both, so they cannot disagree."""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from astropy.io import fits
from astropy.utils.exceptions import AstropyWarning

from ..errors import BadInput
from ..records import CalibrationMap
from .map_layout import BLOCK, CARD, SCHEMA, TABLES, describe, digest, header_end, rebuild, required_extensions

RESTORE = "restore the file from a copy, or measure and write the map again"
HOW_TO_MEND = {
    "readable": "check the path; `--map-out` writes a map",
    "a calibench map": "give a map that calibench wrote",
    "schema": "use the calibench version that wrote it, or measure the map again with this one",
}


class Check(NamedTuple):
    """One thing that was verified of a map file."""

    name: str
    ok: bool
    detail: str


class _Failed(Exception):
    """A check has failed; the message says how. The checks after it would mean nothing."""


def read_map(path: Path | str) -> CalibrationMap:
    """The map in a file, after every check of `verify_map`.

    Raises:
        BadInput: the file is missing, not a map, of an unknown schema, cut short, damaged or incomplete.
    """
    checks, calmap = _inspect(path)
    if calmap is None:
        failed = checks[-1]
        raise BadInput(failed.detail, file=path, mend=HOW_TO_MEND.get(failed.name, RESTORE))
    return calmap


def verify_map(path: Path | str) -> list[Check]:
    """The checks of a map file, in order, up to the first that fails. All are ok exactly where `read_map` succeeds."""
    return _inspect(path)[0]


def map_info(path: Path | str) -> dict:
    """What a map file says about itself, as plain JSON values (see `map_layout.describe`).

    Raises:
        BadInput: as `read_map`.
    """
    return describe(read_map(path))


def _inspect(path: Path | str) -> tuple[list[Check], CalibrationMap | None]:
    checks, inspection = [], _Inspection(Path(path))
    for name, check in _Inspection.CHECKS:
        try:
            checks.append(Check(name, True, check(inspection)))
        except _Failed as failure:
            checks.append(Check(name, False, str(failure)))
            return checks, None
    return checks, inspection.calmap


class _Inspection:
    """One file under inspection. Each check builds on what those before it have found, and answers with a detail."""

    def __init__(self, path: Path):
        self.path = path

    def readable(self) -> str:
        if not self.path.is_file():
            raise _Failed("there is no such file" if not self.path.exists() else "this is not a file")
        self.head = _read(self.path, BLOCK)
        return f"{self.path.stat().st_size} bytes"

    def is_calibench_map(self) -> str:
        if not self.head.startswith(b"SIMPLE  ="):
            raise _Failed("this is not a FITS file" if self.head else "the file is empty")
        self.schema = _integer_card(self.head, b"CBSCHEMA")
        if self.schema is None:
            raise _Failed("this FITS file is no calibench map (it has no CBSCHEMA), or its header is damaged")
        return "FITS with CBSCHEMA"

    def has_known_schema(self) -> str:
        if self.schema != SCHEMA:
            raise _Failed(f"the map has schema {self.schema}, this calibench reads schema {SCHEMA}")
        return str(SCHEMA)

    def has_its_length(self) -> str:
        # Before anything is loaded: a file that grew or claims too much is never read into memory.
        claimed, actual = _integer_card(self.head, b"FILESIZE"), self.path.stat().st_size
        if claimed != actual:
            how = "cut short" if claimed is not None and actual < claimed else "damaged"
            raise _Failed(f"the file is {how}: it has {actual} bytes and says it has {claimed}")
        return f"{actual} bytes"

    def has_its_sha256(self) -> str:
        self.content = _read(self.path)
        cards = (self.content[at:at + CARD] for at in range(0, header_end(self.content), CARD))
        stated = [card.split(b"'")[1].decode("ascii", "replace") for card in cards if card.startswith(b"SHA256  = '")]
        actual = digest(self.content)
        if stated != [actual]:
            raise _Failed("the file is damaged: its SHA-256 does not match its content")
        return actual

    def has_its_fits_sums(self) -> str:
        with _strict_fits(self.content) as hdus:
            for hdu in hdus:
                if hdu.verify_checksum() != 1 or hdu.verify_datasum() != 1:
                    raise _Failed(f"the file is damaged: CHECKSUM or DATASUM of {hdu.name} is wrong or missing")
            return f"{len(hdus)} HDUs"

    def has_its_extensions(self) -> str:
        with _strict_fits(self.content) as hdus:
            names = {hdu.header.get("KEY", hdu.name) for hdu in hdus}
            missing = [name for name in TABLES if name not in names]
            if not missing:
                self.meta = json.loads(hdus["METADATA"].data["JSON"][0])
                missing = [name for name in required_extensions(self.meta) if name not in names]
            if missing:
                raise _Failed(f"required extensions are missing: {', '.join(missing)}")
            self.arrays = {hdu.header["KEY"]: _array(hdu) for hdu in hdus if "KEY" in hdu.header}
        return f"{len(self.arrays)} arrays"

    def holds_a_map(self) -> str:
        with _layout_errors():
            self.calmap = rebuild(self.meta, self.arrays)
        return f"layers: {', '.join(sorted(self.calmap.measured)) or 'none'}"

    CHECKS = (("readable", readable), ("a calibench map", is_calibench_map), ("schema", has_known_schema),
              ("length", has_its_length), ("SHA-256", has_its_sha256), ("FITS checksums", has_its_fits_sums),
              ("extensions", has_its_extensions), ("content", holds_a_map))


def _read(path: Path, count: int = -1) -> bytes:
    try:
        with open(path, "rb") as handle:
            return handle.read(count)
    except OSError as error:
        raise _Failed(f"cannot be read: {error.strerror or error}") from error


def _integer_card(header: bytes, keyword: bytes) -> int | None:
    """The whole number of one card, read without a FITS parser, so that a damaged header cannot upset it."""
    for at in range(0, len(header), CARD):
        card = header[at:at + CARD]
        if card.startswith(keyword.ljust(8) + b"= "):
            text = card[10:].split(b"/")[0].strip()
            return int(text) if text.isdigit() else None
    return None


@contextmanager
def _layout_errors() -> Iterator[None]:
    """What is raised on a file that is as written but does not follow the layout is a failed check."""
    try:
        yield
    except (OSError, LookupError, TypeError, ValueError, AttributeError, RecursionError, fits.VerifyError,
            AstropyWarning, BadInput) as error:
        raise _Failed(f"the file does not follow the layout of schema {SCHEMA}: {error}") from error


@contextmanager
def _strict_fits(content: bytes) -> Iterator[fits.HDUList]:
    """The file opened by astropy, whose warnings are errors here."""
    with _layout_errors(), warnings.catch_warnings():
        warnings.simplefilter("error", AstropyWarning)
        with fits.open(io.BytesIO(content)) as hdus:
            yield hdus


def _array(hdu: fits.ImageHDU | fits.BinTableHDU) -> np.ndarray:
    """The array of an extension with its own dtype and shape, in native byte order."""
    shape = tuple(int(n) for n in hdu.header["SHAPE"].split(",") if n)
    dtype = np.dtype(hdu.header["DTYPE"])
    if dtype.kind == "U":
        texts = [text.encode("ascii").decode("unicode_escape") for text in hdu.data["TEXT"]]
        return np.array(texts, dtype=dtype).reshape(shape)
    stored = hdu.data if hdu.data is not None else np.zeros(0, dtype)
    return np.ascontiguousarray(stored).astype(dtype).reshape(shape)
