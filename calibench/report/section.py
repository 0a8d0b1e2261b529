"""Section and what it holds: paragraphs, warnings, tables and figures, as plain text and bytes. Escaping is the template's."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Badge:
    """A status in a table cell; printed as sign and word, so that it does not rely on colour."""

    status: str

    @property
    def tone(self) -> str:
        """good, bad or open."""
        return {"pass": "good", "solved": "good", "fail": "bad", "no_match": "bad", "too_few_spots": "bad",
                "rejected": "bad"}.get(self.status, "open")

    @property
    def sign(self) -> str:
        return {"good": "✓", "bad": "✗", "open": "–"}[self.tone]

    @property
    def word(self) -> str:
        return self.status.replace("_", " ")


@dataclass(frozen=True, kw_only=True)
class Table:
    """columns: heads with their unit. numbers: heads of the columns that are right-aligned. codes: heads of columns in a fixed
    width (hashes, paths). Each row has one cell a column."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str | Badge, ...], ...]
    numbers: frozenset[str] = frozenset()
    codes: frozenset[str] = frozenset()
    note: str = ""

    def __post_init__(self) -> None:
        unknown = (self.numbers | self.codes) - set(self.columns)
        if unknown or any(len(row) != len(self.columns) for row in self.rows):
            raise ValueError(f"table '{self.title}': unknown columns {sorted(unknown)} or a row of another length")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """png: the image. reading: one line with the figures that the image shows. wide: takes the whole width of the page."""

    title: str
    png: bytes
    reading: str
    wide: bool = False


@dataclass(frozen=True, kw_only=True)
class Section:
    """One chapter of the report; its title and place are its file's TITLE and ORDER."""

    paragraphs: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
