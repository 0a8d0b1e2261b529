"""The shipped bright-star table: Hipparcos stars to Hp 7, with HR numbers, V and types of the Bright Star Catalogue."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..records import StarTable

SHIPPED = Path(__file__).parent / "data" / "stars_hp7.npz"
COLUMNS = tuple(f for f in StarTable.__dataclass_fields__ if f not in ("epoch_jyear", "source"))


def load_star_table(path: Path = SHIPPED) -> StarTable:
    """The star table of `path` (default: the shipped one), brightest (Hp) first.

    Raises:
        BadInput: missing, damaged, or not a star table.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            columns = {name: file[name] for name in COLUMNS}
            return StarTable(epoch_jyear=float(file["epoch_jyear"]), source=str(file["source"]), **columns)
    except (OSError, KeyError, ValueError, EOFError) as fault:
        raise BadInput(f"not a readable star table ({fault})", file=path,
                       mend="reinstall calibench, or build it with python -m calibench.io.star_table_build") from fault


def write_star_table(path: Path, table: StarTable) -> None:
    """Write `table` as a compressed npz of plain arrays."""
    arrays = {name: getattr(table, name) for name in COLUMNS}
    np.savez_compressed(path, epoch_jyear=table.epoch_jyear, source=table.source, **arrays)
