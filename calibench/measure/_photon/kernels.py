"""Sums over a frame, over a pair of frames, and over the sum of a stack: each pixel is touched once.

The pair's sums are doubles that hold whole numbers (below 2^53, so exact in any order, and quicker than integers), but for the
fourth power, which only an error bar needs.
"""

from __future__ import annotations

import numpy as np

from ...kernels import any_order, compiled


@compiled
def top(data):
    """Largest value of data (H, W) uint16, and how many pixels have it."""
    maximum, count = data[0, 0], 0
    for y in range(data.shape[0]):
        most = data[y, 0]
        for x in range(data.shape[1]):
            most = max(most, data[y, x])
        if most > maximum:
            maximum, count = most, 0
        if most == maximum:
            for x in range(data.shape[1]):
                count += data[y, x] == most
    return maximum, count


@any_order
def pair(earlier, later):
    """Sums over two frames (H, W) uint16: of d = later - earlier, d^2, d^4, d times its right, d times its lower neighbour, of
    (earlier + later)^2; then the sums of earlier + later over each column (W,) and each row (H,)."""
    height, width = earlier.shape
    plain, squares, fourth, right, below, both = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    above, d = np.zeros(width), np.zeros(width)
    columns, rows = np.zeros(width), np.zeros(height)
    for y in range(height):
        row = 0.0
        for x in range(width):
            u, v = np.float64(earlier[y, x]), np.float64(later[y, x])
            d[x] = v - u
            columns[x] += u + v
            row += u + v
            both += (u + v) * (u + v)
        for x in range(width):
            square = d[x] * d[x]
            plain += d[x]
            squares += square
            fourth += square * square
            below += d[x] * above[x]
            above[x] = d[x]
        for x in range(1, width):
            right += d[x] * d[x - 1]
        rows[y] = row
    return plain, squares, fourth, right, below, both, columns, rows


@compiled
def add(data, total):
    """Add data (H, W) uint16 to total (H, W) uint32. Gives its sum and its sum of squares."""
    plain, squares = np.int64(0), np.int64(0)
    for y in range(data.shape[0]):
        for x in range(data.shape[1]):
            value = np.int64(data[y, x])
            total[y, x] += np.uint32(value)
            plain += value
            squares += value * value
    return plain, squares


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
