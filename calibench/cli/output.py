"""What a person or a program reads: tables and progress on a terminal, one JSON object with --json."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated

import typer

Json = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout.")]


def say(text: str) -> None:
    """A message for the person: stderr, so that stdout stays for results."""
    print(text, file=sys.stderr)


def print_json(values: dict) -> None:
    """The one JSON object of a command."""
    print(json.dumps(values, allow_nan=False))


def number(value: float | None, digits: int = 4) -> str:
    """A figure for a table; a dash where there is none."""
    if value is None:
        return "-"
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Aligned columns: text to the left, figures to the right."""
    cells = [[c if isinstance(c, str) else number(c) for c in row] for row in rows]
    widths = [max(len(line[i]) for line in [list(header), *cells]) for i in range(len(header))]
    right = [any(not isinstance(row[i], str) for row in rows) for i in range(len(header))]

    def line(parts: Sequence[str]) -> str:
        return "  ".join(p.rjust(w) if r else p.ljust(w) for p, w, r in zip(parts, widths, right, strict=True)).rstrip()
    return "\n".join([line(header), line(["-" * w for w in widths]), *map(line, cells)])


@contextmanager
def progress() -> Iterator[object]:
    """A function tell(stage, done, total) that draws a bar while a person watches, and nothing into a file or pipe."""
    if not sys.stderr.isatty():
        yield lambda stage, done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
    columns = (TextColumn("{task.description:24}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1)
        yield lambda stage, done, total: bar.update(task, description=stage, completed=done, total=total)
