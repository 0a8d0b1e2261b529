"""Compiled: windows cut out of an image, robust statistics of cells, and their interpolation back to pixels."""

from __future__ import annotations

from math import sqrt

import numba
import numpy as np

from ..kernels import compiled

# Sums may be reordered, so that they fill the vector unit; NaN and infinity keep their meaning.
fast = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})

CLIP_SIGMA = 3.5  # at 3 the mean of skewed noise (a dark sky's few electrons) would lie 0.04 sigma * skewness too low
CLIP_ROUNDS = 6
INSIDE_CLIP = 0.99694  # a Gaussian's standard deviation inside the clip
SETTLED = 1e-3
START_SAMPLES = 64
QUARTILES = 1.349  # distance of a Gaussian's quartiles, sigma


@compiled
def cut(image, centre_xy, radius, outside):
    """Square windows (N, 2r+1, 2r+1) of an image (H, W) about integer centres (N, 2); `outside` beyond its edge."""
    h, w = image.shape
    side = 2 * radius + 1
    out = np.full((len(centre_xy), side, side), outside, image.dtype)
    for n in range(len(centre_xy)):
        x0, y0 = centre_xy[n, 0] - radius, centre_xy[n, 1] - radius
        for j in range(max(0, -y0), min(side, h - y0)):
            for i in range(max(0, -x0), min(side, w - x0)):
                out[n, j, i] = image[y0 + j, x0 + i]
    return out


@compiled
def crowded(xy, apart):
    """Whether each of (N, 2) points has another one nearer than `apart`: (N,) bool."""
    near = np.zeros(len(xy), np.bool_)
    for n in range(len(xy)):
        for m in range(n):
            dx, dy = xy[n, 0] - xy[m, 0], xy[n, 1] - xy[m, 1]
            if dx * dx + dy * dy < apart * apart:
                near[n] = near[m] = True
    return near


@compiled
def nearer_to_another(xy, corner_xy, side):
    """Pixels of the windows (N, side, side) at corner_xy (N, 2) that lie nearer to another of the spots, xy (N, 2)."""
    out = np.zeros((len(xy), side, side), np.bool_)
    for n in range(len(xy)):
        for m in range(len(xy)):
            dx, dy = xy[m, 0] - xy[n, 0], xy[m, 1] - xy[n, 1]
            if m == n or max(abs(dx), abs(dy)) > 2 * side:
                continue
            for j in range(side):
                for i in range(side):
                    # beyond the line half way between the two
                    x, y = corner_xy[n, 0] + i - xy[n, 0] - dx / 2, corner_xy[n, 1] + j - xy[n, 1] - dy / 2
                    if x * dx + y * dy > 0:
                        out[n, j, i] = True
    return out


@compiled
def cell_statistics(image, cell, floor):
    """Level and 1-sigma noise of the cells of an image (H, W) float32, NaN where a pixel does not count.

    Median and quartiles of a sample, then mean, plane and standard deviation of what lies within the clip of the plane,
    until stable: stars fall out, a slope across the cell is no noise. floor: least noise, DN.

    Returns:
        level, noise (rows, columns) float64, NaN where fewer than an eighth of the pixels count.
    """
    h, w = image.shape
    rows, columns = (h + cell - 1) // cell, (w + cell - 1) // cell
    level, noise = np.full((rows, columns), np.nan), np.full((rows, columns), np.nan)
    values, sample = np.empty(cell * cell, np.float32), np.empty(START_SAMPLES, np.float32)
    us, vs = np.empty(cell * cell, np.float32), np.empty(cell * cell, np.float32)
    for r in range(rows):
        for c in range(columns):
            y0, y1, x0, x1 = r * cell, min((r + 1) * cell, h), c * cell, min((c + 1) * cell, w)
            count = 0
            for y in range(y0, y1):
                for x in range(x0, x1):
                    if image[y, x] == image[y, x]:
                        values[count] = image[y, x]
                        us[count], vs[count] = x - 0.5 * (x0 + x1 - 1), y - 0.5 * (y0 + y1 - 1)
                        count += 1
            if count < cell * cell // 8:
                continue
            taken = min(count, START_SAMPLES)
            for k in range(taken):  # sorted by insertion
                value, n = values[k * count // taken], k
                while n > 0 and sample[n - 1] > value:
                    sample[n] = sample[n - 1]
                    n -= 1
                sample[n] = value
            spread = (sample[3 * taken // 4] - sample[taken // 4]) / QUARTILES + floor
            middle = sample[taken // 2]
            centre, spread, along_x, along_y = _clipped(values[:count], us[:count], vs[:count], middle, spread, floor)
            # A cell that the image's edge cuts is given the level at the centre that a whole one has.
            level[r, c] = centre + along_x * 0.5 * (x0 + cell - x1) + along_y * 0.5 * (y0 + cell - y1)
            noise[r, c] = spread
    return level, noise


@fast
def _clipped(values, us, vs, middle, spread, floor):
    """Level at the centre, noise and slopes, clipped about a plane; the pixels stand on a grid, so slopes decouple."""
    along_x = along_y = np.float32(0)
    centre, limit = np.float32(middle), np.float32(CLIP_SIGMA * spread)
    for _ in range(CLIP_ROUNDS):
        n = s0 = s2 = su = sv = suu = svv = np.float32(0)
        for k in range(len(values)):
            d = values[k] - centre - along_x * us[k] - along_y * vs[k]
            inside = np.float32(1) if abs(d) <= limit else np.float32(0)
            d *= inside
            n, s0, s2 = n + inside, s0 + d, s2 + d * d
            su, sv = su + d * us[k], sv + d * vs[k]
            suu, svv = suu + inside * us[k] * us[k], svv + inside * vs[k] * vs[k]
        if n < 4:
            break
        shift = s0 / n
        centre += shift
        along_x += su / max(suu, np.float32(1))
        along_y += sv / max(svv, np.float32(1))
        slopes = su * su / max(suu, np.float32(1)) + sv * sv / max(svv, np.float32(1))
        old = spread
        spread = max(sqrt(max(s2 - shift * s0 - slopes, np.float32(0)) / (n - np.float32(3))) / INSIDE_CLIP, floor)
        limit = np.float32(CLIP_SIGMA * spread)
        if abs(spread - old) < SETTLED * spread and abs(shift) < SETTLED * spread:
            break
    return centre, spread, along_x, along_y


@compiled
def to_pixels(cells, cell, height, width):
    """Cell values (rows, columns), at the cells' centres, to (height, width) float32: bilinear, and so beyond the outermost."""
    rows, columns = cells.shape
    out = np.empty((height, width), np.float32)
    line = np.empty(columns)
    for y in range(height):
        at = (y + 0.5) / cell - 0.5
        r = min(max(int(at), 0), max(rows - 2, 0))
        part = at - r if rows > 1 else 0.0
        for c in range(columns):
            line[c] = cells[r, c] * (1 - part) + cells[min(r + 1, rows - 1), c] * part
        for c in range(max(columns - 1, 1)):
            first, step = line[c], (line[min(c + 1, columns - 1)] - line[c]) / cell
            start = c * cell + 0.5 * (cell - 1)
            begin, end = 0 if c == 0 else c * cell + cell // 2, width if c >= columns - 2 else (c + 1) * cell + cell // 2
            for x in range(begin, end):
                out[y, x] = first + step * (x - start)
    return out


@fast
def drift(data, expected, noise, cell, every):
    """How far a frame (H, W) lies above the expectation, from every `every`-th row.

    Returns:
        per cell, smoothed with its neighbours, the mean of (data - expected) / noise within the clip (rows, columns); the mean
        square of it over the frame, as part of a Gaussian's.
    """
    h, w = data.shape
    rows, columns = (h + cell - 1) // cell, (w + cell - 1) // cell
    level, count = np.zeros((rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    squares = np.float32(0)
    limit = np.float32(CLIP_SIGMA)
    for y in range(every // 2, h, every):
        for c in range(columns):
            n = total = square = np.float32(0)
            for x in range(c * cell, min((c + 1) * cell, w)):
                z = (np.float32(data[y, x]) - expected[y, x]) / noise[y, x]
                inside = abs(z) <= limit
                n += np.float32(1) if inside else np.float32(0)
                total += z if inside else np.float32(0)
                square += z * z if inside else np.float32(0)
            level[y // cell, c] += total
            count[y // cell, c] += n
            squares += square
    smooth, square = np.zeros((rows, columns)), squares / max(count.sum(), np.float32(1)) / np.float32(INSIDE_CLIP**2)
    for r in range(rows):  # each cell with its neighbours, by their numbers of pixels
        for c in range(columns):
            total = number = 0.0
            for j in range(max(r - 1, 0), min(r + 2, rows)):
                for i in range(max(c - 1, 0), min(c + 2, columns)):
                    part = (2 - abs(j - r)) * (2 - abs(i - c))
                    total, number = total + part * level[j, i], number + part * count[j, i]
            smooth[r, c] = total / number if number > 0 else 0.0
    return smooth, square
