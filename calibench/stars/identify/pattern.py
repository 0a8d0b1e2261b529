"""The default: triangles by their sides where the lens is known, four-star patterns by side ratios where it is not.

A known lens measures angles, and three of them are enough (_triangles.py). An unknown lens leaves only what scale and
handedness do not change: the five ratios of a four-star pattern's sides (_patterns.py).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..code_table import CodeTable
from ..sky_catalogue import SkyCatalogue
from ..view import View
from . import _patterns, _triangles

NEEDS_SCALE = False
Table = CodeTable
KINDS = {"triangles": _triangles, "patterns": _patterns}


def table_key(view: View) -> tuple[str, tuple[float, ...]]:
    """The kind of groups, and for which sizes of field."""
    kind = "triangles" if view.calibrated else "patterns"
    return kind, KINDS[kind].table_key(view)


def build(sky: SkyCatalogue, key: tuple[str, tuple[float, ...]]) -> CodeTable:
    """The sky's triangles or patterns for such fields."""
    kind, sizes = key
    return KINDS[kind].build(sky, sizes)


def propose(view: View, sky: SkyCatalogue, table: CodeTable) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Correspondences (B, 3 or 4) spot rows and star rows, in batches."""
    return (_triangles if view.calibrated else _patterns).propose(view, sky, table)
