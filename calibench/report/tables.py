"""Tables that several sections share."""

from __future__ import annotations

from collections.abc import Iterable

from ..records import Quantity
from .numbers import sigma, with_uncertainty
from .section import Table

COLUMNS = ("Quantity", "Value ± 1σ", "3σ", "Unit", "Definition")
NUMBERS = frozenset({"Value ± 1σ", "3σ"})


def quantity_table(title: str, quantities: Iterable[Quantity]) -> Table:
    """One row a quantity."""
    return Table(title=title, columns=COLUMNS, rows=tuple(quantity_row(q) for q in quantities), numbers=NUMBERS)


def quantity_row(quantity: Quantity) -> tuple[str, ...]:
    """Name, value ± 1 sigma, 3 sigma, unit, definition or the reason why there is no value."""
    symbol = f" ({quantity.symbol})" if quantity.symbol and quantity.symbol not in quantity.name else ""
    note = "; ".join(text for text in (quantity.source, quantity.reason) if text)
    return (quantity.name + symbol, with_uncertainty(quantity.value, quantity.uncertainty), sigma(quantity.uncertainty, 3),
            "" if quantity.unit == "1" else quantity.unit, note)
