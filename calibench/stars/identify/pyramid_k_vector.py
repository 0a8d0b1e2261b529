"""The pyramid of pyramid.py, pairs found without search by a k-vector on a line (Mortari and Neta 2000)."""

from __future__ import annotations

from ..k_vector import KVectorPairs
from ..sky_catalogue import SkyCatalogue
from . import pyramid

NEEDS_SCALE = True
Table = KVectorPairs
table_key = pyramid.table_key
propose = pyramid.propose


def build(sky: SkyCatalogue, key: float) -> KVectorPairs:
    """The pyramid's pairs with their search."""
    return KVectorPairs.of(pyramid.build(sky, key), quadratic=False)
