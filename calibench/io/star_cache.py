"""Tables of star patterns kept between runs, in the user's cache folder: one npz of plain arrays for each.

A table is taken only if it was written by this program's own code for it, of this star table, and whole: its name carries the
stars and the parameters, its content the hash of the code that built it and of its arrays. Any other file is rebuilt, and said.
"""

from __future__ import annotations

import hashlib
import io
import os
import sys
import zipfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import BadInput
from . import atomic
from .star_table import array_hash

BUILDERS = Path(__file__).parents[1] / "stars"
LARGEST_BYTES = 200_000_000


def cache_folder() -> Path:
    """CALIBENCH_CACHE, or calibench below the user's cache folder (XDG_CACHE_HOME, else ~/.cache)."""
    named = os.environ.get("CALIBENCH_CACHE")
    return Path(named) if named else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "calibench"


@lru_cache(maxsize=1)
def _builders_hash() -> str:
    digest = hashlib.sha256()
    for file in sorted(BUILDERS.rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def kept(name: str, table: type[NamedTuple], build: Callable[[], NamedTuple]) -> NamedTuple:
    """The table of that name from the cache; where it is absent or not to be trusted it is built and written there.

    A folder that cannot be written to costs only the time of building.
    """
    path = cache_folder() / f"{name}.npz"
    try:
        return _read(path, table)
    except FileNotFoundError:
        pass
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as fault:
        print(f"calibench: {path}: kept table not used ({fault}); built anew", file=sys.stderr)
    built = build()
    arrays = {field: np.asarray(value) for field, value in built._asdict().items()}
    content = io.BytesIO()
    np.savez(content, hash=array_hash(_builders_hash(), arrays), **arrays)
    try:
        atomic.make_folder(path.parent)
        atomic.write_bytes(path, content.getvalue())
    except BadInput as fault:
        print(f"calibench: {fault.what}: tables are not kept", file=sys.stderr)
    return built


def _read(path: Path, table: type[NamedTuple]) -> NamedTuple:
    if path.stat().st_size > LARGEST_BYTES:
        raise ValueError("too large")
    with np.load(path, allow_pickle=False) as file:
        arrays = {field: file[field] for field in table._fields}
        if str(file["hash"]) != array_hash(_builders_hash(), arrays):
            raise ValueError("of another version, or damaged")
    return table(**arrays)
