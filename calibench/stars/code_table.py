"""CodeTable: groups of stars that are found again by a code, a short vector such as three sides or five ratios.

1. A code is put into a cell of a grid over all its dimensions; the cells are hashed into buckets.
2. A question is a box, code +- tolerance: the cells that the box touches are looked up, and their entries compared.

With cells about twice as large as the usual tolerance a question touches few of them, however many codes there are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from . import kernels


class CodeTable(NamedTuple):
    """codes (Q, d) float32 and rows (Q, k) int32 star rows, sorted by bucket; start (B + 1,) int32; cell (d,) cell sizes."""

    codes: np.ndarray
    rows: np.ndarray
    start: np.ndarray
    cell: np.ndarray

    @classmethod
    def of(cls, codes: np.ndarray, rows: np.ndarray, cell: np.ndarray) -> CodeTable:
        """codes (Q, d) of groups of stars (Q, k); cell (d,): about twice the tolerance that is usually asked with."""
        codes, cell = np.ascontiguousarray(codes, np.float32), np.ascontiguousarray(cell, float)
        buckets = 1 << max(int(np.ceil(np.log2(len(codes) + 1))), 1)
        bucket = kernels.bucket_of(codes, cell, buckets)
        order = np.argsort(bucket, kind="stable")
        start = np.searchsorted(bucket[order], np.arange(buckets + 1)).astype(np.int32)
        return cls(codes=codes[order], rows=np.ascontiguousarray(rows[order], np.int32), start=start, cell=cell)

    def near(self, codes: np.ndarray, tolerance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(owner (F,), entry (F,)): which question found which entry, for codes (G, d) within tolerance (G, d)."""
        return kernels.codes_near(self, np.ascontiguousarray(codes, float), np.ascontiguousarray(tolerance, float))
