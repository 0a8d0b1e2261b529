"""Provenance: every quantity with its definition, every input with its hash, settings and software."""

from __future__ import annotations

from ..section import Section, Table
from ..story import Story
from ..tables import COLUMNS, NUMBERS, quantity_row

ORDER = 90
TITLE = "Provenance"


def render(story: Story) -> Section:
    calmap = story.calmap
    quantities = tuple((key.partition(".")[0], *quantity_row(quantity)) for key, quantity in calmap.quantities.items())
    tables = (
        Table(title="Every quantity", columns=("Measurement", *COLUMNS), rows=quantities, numbers=NUMBERS),
        Table(title="Settings", columns=("Measurement", "Setting", "Value"), codes=frozenset({"Value"}), rows=tuple(
            (measurement, name, _text(value)) for measurement, settings in calmap.settings.items()
            for name, value in _items(settings))),
        Table(title="Input frames", columns=("Measurement", "File", "SHA-256"), codes=frozenset({"File", "SHA-256"}),
              rows=tuple((*_parted(key), sha256) for key, sha256 in calmap.inputs.items())),
        Table(title="Software", columns=("What", "Value"), codes=frozenset({"Value"}), rows=tuple(
            (what, value) for what, value in (("report made by", story.software), ("map made by", calmap.software),
                                              ("map created", calmap.created), ("protocol SHA-256", calmap.protocol_sha256))
            if value)))
    return Section(paragraphs=("With these inputs, settings and this software the map can be made again.",),
                   tables=tuple(table for table in tables if table.rows))


def _items(settings: object) -> list[tuple[str, object]]:
    return list(settings.items()) if hasattr(settings, "items") else [("", settings)]


def _parted(key: str) -> tuple[str, str]:
    measurement, _, file = key.partition("/")
    return measurement, file


def _text(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_text(part) for part in value)
    return "not set" if value is None else str(value)
