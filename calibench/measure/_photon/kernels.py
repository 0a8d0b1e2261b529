"""Sums over one frame, over the difference of two, and over the sum of a level: each pixel is touched once.

Integers throughout (exact), but for the fourth power, which only an error bar needs.
"""

from __future__ import annotations

import numpy as np

from ...kernels import compiled


@compiled
def add(data, total):
    """Add data (H, W) uint16 to total (H, W) uint32. Gives its sum, sum of squares, maximum, and the pixels at that."""
    plain, squares, maximum, at_maximum = np.int64(0), np.int64(0), np.int64(-1), np.int64(0)
    for y in range(data.shape[0]):
        for x in range(data.shape[1]):
            value = np.int64(data[y, x])
            total[y, x] += np.uint32(value)
            plain += value
            squares += value * value
            maximum = max(maximum, value)
    for y in range(data.shape[0]):
        for x in range(data.shape[1]):
            at_maximum += np.int64(data[y, x]) == maximum
    return plain, squares, maximum, at_maximum


@compiled
def difference(earlier, later):
    """Sums over d = later - earlier, (H, W) uint16 each: d, d^2, d^4, d times its right, d times its lower neighbour."""
    plain, squares, right, below, fourth = np.int64(0), np.int64(0), np.int64(0), np.int64(0), 0.0
    above = np.zeros(earlier.shape[1], np.int64)
    for y in range(earlier.shape[0]):
        left = np.int64(0)
        row_fourth = 0.0
        for x in range(earlier.shape[1]):
            d = np.int64(later[y, x]) - np.int64(earlier[y, x])
            square = d * d
            plain += d
            squares += square
            row_fourth += float(square) * float(square)
            right += d * left
            below += d * above[x]
            left = d
            above[x] = d
        fourth += row_fourth
    return plain, squares, fourth, right, below


@compiled
def lines(total, centre):
    """Of total (H, W) uint32: the sum of (total - centre)^2, the sums of total over each column (W,) and each row (H,)."""
    squares = np.int64(0)
    columns, rows = np.zeros(total.shape[1], np.int64), np.zeros(total.shape[0], np.int64)
    for y in range(total.shape[0]):
        row = np.int64(0)
        for x in range(total.shape[1]):
            value = np.int64(total[y, x])
            row += value
            columns[x] += value
            squares += (value - centre) * (value - centre)
        rows[y] = row
    return squares, columns, rows
