"""Star tables on disk: the shipped one, and those that `catalogue build` made of it for one camera.

The shipped one holds Hipparcos stars to Hp 7, with HR numbers, V and types of the Bright Star Catalogue. A table that was
written here carries the SHA-256 of its content.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..records import StarTable
from . import atomic

SHIPPED = Path(__file__).parent / "data" / "stars_hp7.npz"
COLUMNS = tuple(f for f in StarTable.__dataclass_fields__ if f not in ("epoch_jyear", "source"))
LARGEST_BYTES = 500_000_000


def load_star_table(path: Path = SHIPPED) -> StarTable:
    """The star table of `path` (default: the shipped one), brightest (Hp) first.

    Raises:
        BadInput: missing, damaged, changed since it was written, or not a star table.
    """
    try:
        if Path(path).stat().st_size > LARGEST_BYTES:
            raise ValueError("too large for a star table")
        if not zipfile.is_zipfile(path):
            raise ValueError("no npz file")
        with np.load(path, allow_pickle=False) as file:
            columns = {name: file[name] for name in COLUMNS}
            table = StarTable(epoch_jyear=float(file["epoch_jyear"]), source=str(file["source"]), **columns)
            if "sha256" in file and str(file["sha256"]) != table_hash(table):
                raise ValueError("its content is not what its SHA-256 says")
            return table
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, BadInput) as fault:
        mend = ("reinstall calibench, or build it with python -m calibench.io.star_table_build" if path == SHIPPED else
                "build it again with calibench catalogue build")
        raise BadInput(f"not a readable star table ({fault})", file=path, mend=mend) from fault


def write_star_table(path: Path, table: StarTable) -> str:
    """Write `table` as a compressed npz of plain arrays, replacing the file whole; its SHA-256.

    Raises:
        BadInput: the file cannot be written.
    """
    arrays = {name: getattr(table, name) for name in COLUMNS}
    content, digest = io.BytesIO(), table_hash(table)
    np.savez_compressed(content, epoch_jyear=table.epoch_jyear, source=table.source, sha256=digest, **arrays)
    atomic.write_bytes(Path(path), content.getvalue())
    return digest


def table_hash(table: StarTable) -> str:
    """SHA-256 over a table's epoch, source and columns."""
    return array_hash(f"{table.epoch_jyear} {table.source}", {name: getattr(table, name) for name in COLUMNS})


def array_hash(head: str, arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 over a text and named arrays, their types and shapes."""
    digest = hashlib.sha256(head.encode())
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
