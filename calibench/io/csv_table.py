"""Tables as CSV: one line a row, the columns' names first, nothing for what is not known."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from . import atomic


def write_csv(path: Path, rows: Sequence[Mapping[str, object]], columns: Sequence[str]) -> None:
    """Write these columns of the rows; lists are written with spaces between their values. The file is replaced whole.

    Raises:
        BadInput: the file cannot be written.
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(columns)
    writer.writerows([[_cell(row[name]) for name in columns] for row in rows])
    atomic.write_bytes(Path(path), text.getvalue().encode("utf-8"))


def _cell(value: object) -> object:
    if value is None:
        return ""
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else value
