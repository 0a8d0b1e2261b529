"""The pyramid of pyramid.py, every row of the pairs is compared: what the other searches are measured against."""

from __future__ import annotations

from ..k_vector import LinearPairs
from ..sky_catalogue import SkyCatalogue
from . import pyramid

NEEDS_SCALE = True
Table = LinearPairs
table_key = pyramid.table_key
propose = pyramid.propose


def build(sky: SkyCatalogue, key: float) -> LinearPairs:
    """The pyramid's pairs with their search."""
    return LinearPairs(*pyramid.build(sky, key))
