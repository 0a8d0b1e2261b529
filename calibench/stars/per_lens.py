"""What follows from a lens alone is computed once for a series of frames, not once a frame."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from ..records import Intrinsics

MOST_LENSES = 64
Result = TypeVar("Result")


def per_lens(function: Callable[[Intrinsics], Result]) -> Callable[[Intrinsics], Result]:
    """Decorator of a function of Intrinsics: its results for the last MOST_LENSES records are kept.

    Records are immutable, so the record itself, not its values, is the key; the weak reference tells it from a later one that
    came to lie at the same address.
    """
    kept: dict[int, tuple[weakref.ref, Result]] = {}

    @wraps(function)
    def once(lens: Intrinsics) -> Result:
        entry = kept.get(id(lens))
        if entry is None or entry[0]() is not lens:
            while len(kept) >= MOST_LENSES:
                kept.pop(next(iter(kept)))
            entry = kept[id(lens)] = weakref.ref(lens), function(lens)
        return entry[1]
    return once
