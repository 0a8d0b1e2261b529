"""Compiled: robust statistics of cells, their interpolation back to pixels; what is done with the windows of spots."""

from __future__ import annotations

from math import erf, sqrt

import numpy as np

from ..kernels import any_order, compiled
from ..records import DEFECT_FLAGS, SPOT_FLAGS, UNUSABLE

CLIP_SIGMA = 3.5  # at 3 the mean of skewed noise (a dark sky's few electrons) would lie 0.04 sigma * skewness too low
CLIP_ROUNDS = 6
INSIDE_CLIP = 0.99694  # a Gaussian's standard deviation inside the clip
BLANK = 0.98  # of a cell at one value: no light falls there; noise of 0.21 DN, rounded, leaves as many
SETTLED = 1e-3
START_SAMPLES = 64
QUARTILES = 1.349  # distance of a Gaussian's quartiles, sigma

EDGE_PX = 2
BLEND_PX = 4.0  # two spots nearer than this stand in one window
LONG = 3.0  # major over minor axis of a trail
SHARPER_SIGMA = 5.0  # a centre above what the PSF allows by this many sigma ...
SHARPER_BY = 1.15  # ... and by this factor, because the PSF map is not exact
SATURATED, DEFECT, EDGE, BLEND, TRAIL, FIT_FAILED, COSMIC = (
    np.uint16(SPOT_FLAGS[name]) for name in ("saturated", "defect", "edge", "blend", "trail", "fit_failed", "cosmic"))
SATURATED_PIXEL = np.uint16(DEFECT_FLAGS["saturated"])
UNUSABLE_PIXEL = np.uint16(UNUSABLE)
BROKEN_PIXEL = np.uint16(UNUSABLE & ~DEFECT_FLAGS["saturated"])


@compiled
def lose_others(xy, corner_xy, signal):
    """Makes NaN in signal (N, side, side), windows at corner_xy (N, 2), what lies nearer to another of the spots xy (N, 2)."""
    side = signal.shape[1]
    for n in range(len(xy)):
        for m in range(len(xy)):
            dx = xy[m, 0] - xy[n, 0]
            if abs(dx) > 2 * side or m == n:
                continue
            dy = xy[m, 1] - xy[n, 1]
            if abs(dy) > 2 * side:
                continue
            for j in range(side):
                for i in range(side):
                    # beyond the line half way between the two
                    x, y = corner_xy[n, 0] + i - xy[n, 0] - dx / 2, corner_xy[n, 1] + j - xy[n, 1] - dy / 2
                    if x * dx + y * dy > 0:
                        signal[n, j, i] = np.nan


@compiled
def above_sky(signal, defects, corner_xy, background, noise, drifted, cell, louder, floor):
    """Takes the sky off windows (N, n, n) float32 at corner_xy (N, 2), makes NaN what cannot be used, fills floor (N, n, n),
    the variance of a pixel without stars.

    background, noise: (H, W) float32. drifted: cells of `cell` px, how far the sky has moved since, in units of the noise;
    louder: by which factor the noise has grown."""
    h, w = background.shape
    side = signal.shape[1]
    for n in range(len(signal)):
        middle_x, middle_y = min(max(corner_xy[n, 0] + side // 2, 0), w - 1), min(max(corner_xy[n, 1] + side // 2, 0), h - 1)
        risen, grown = np.float32(drifted[middle_y // cell, middle_x // cell]), np.float32(louder)
        for j in range(side):
            for i in range(side):
                x, y = corner_xy[n, 0] + i, corner_xy[n, 1] + j
                floor[n, j, i] = 1.0
                if x < 0 or y < 0 or x >= w or y >= h:
                    continue
                sigma = noise[y, x]
                signal[n, j, i] -= background[y, x] + risen * sigma
                floor[n, j, i] = (sigma * grown) ** 2
                if defects[n, j, i] & UNUSABLE_PIXEL:
                    signal[n, j, i] = np.nan


@compiled
def gaussian_moments(xy, coefficients, degree, width, height, least, steepest, out):
    """Fills out (N, 3), s_xx s_yy s_xy at xy (N, 2), from polynomials over the field (spots/_field.py).

    coefficients: (3, terms). Variances are kept above `least`, the correlation below `steepest`."""
    for n in range(len(xy)):
        u, v = 2 * xy[n, 0] / (width - 1) - 1, 2 * xy[n, 1] / (height - 1) - 1
        for k in range(3):
            term, value = 0, 0.0
            for total in range(degree + 1):
                for power in range(total + 1):
                    value += coefficients[k, term] * u ** (total - power) * v**power
                    term += 1
            out[n, k] = value
        out[n, 0], out[n, 1] = max(out[n, 0], least), max(out[n, 1], least)
        limit = steepest * sqrt(out[n, 0] * out[n, 1])
        out[n, 2] = min(max(out[n, 2], -limit), limit)


@compiled
def flag_spots(xy, peak_xy, ok, blend, elongation, signal, defects, noise, background, width, height, moments, gain, flags):
    """Fills flags (N,) uint16, as `spots/flags.py` describes them.

    signal, defects: (N, 3, 3) about the peaks. background: (N,), what the fit found to be left. moments: (N, 3), or (0, 3)
    where the PSF is not known."""
    for n in range(len(xy)):
        total = peak = 0.0
        x, y = peak_xy[n, 0], peak_xy[n, 1]
        for j in range(3):
            for i in range(3):
                inside = 0 <= x + i - 1 < width and 0 <= y + j - 1 < height
                value = signal[n, j, i]
                if defects[n, j, i] & SATURATED_PIXEL:
                    flags[n] |= SATURATED
                if defects[n, j, i] & BROKEN_PIXEL or (inside and not abs(value) < np.inf):
                    flags[n] |= DEFECT
                elif inside:
                    value -= background[n] if ok[n] else 0.0
                    total += value
                    if i == 1 and j == 1:
                        peak = value
        if min(x, y, width - 1 - x, height - 1 - y) < EDGE_PX:
            flags[n] |= EDGE
        if blend[n]:
            flags[n] |= BLEND
        for m in range(n):
            dx, dy = xy[n, 0] - xy[m, 0], xy[n, 1] - xy[m, 1]
            if dx * dx + dy * dy < BLEND_PX * BLEND_PX:
                flags[n] |= BLEND
                flags[m] |= BLEND
        if elongation[n] > LONG:
            flags[n] |= TRAIL
        if not ok[n]:
            flags[n] |= FIT_FAILED
        if len(moments):
            # The peak pixel's part of the 3x3's light, at most, wherever in the pixel the spot stands.
            sx, sy = sqrt(2 * moments[n, 0]), sqrt(2 * moments[n, 1])
            allowed = erf(0.5 / sx) / erf(1.5 / sx) * erf(0.5 / sy) / erf(1.5 / sy)
            total = max(total, 1e-6)
            shot = gain * max(peak, 0.0) * (1 - allowed) ** 2
            sd = sqrt(noise[n] ** 2 * (1 + 8 * allowed**2) + shot) / total
            part = peak / total
            if part > SHARPER_BY * allowed and part - allowed > SHARPER_SIGMA * sd:
                flags[n] |= COSMIC


@compiled
def cell_statistics(image, cell, floor):
    """Level and 1-sigma noise of the cells of an image (H, W) float32, NaN where a pixel does not count.

    Median and quartiles of a sample, then mean, plane and standard deviation of what lies within the clip of the plane,
    until stable: stars fall out, a slope across the cell is no noise. floor: least noise, DN.

    Returns:
        level, noise (rows, columns) float64, NaN where fewer than an eighth of the pixels count; noise NaN, too, where
        BLANK of them are of one value: beyond the image circle, a black border, cut off at black.
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
            same = 0
            for k in range(count):
                same += 1 if values[k] == middle else 0
            centre, spread, along_x, along_y = _clipped(values[:count], us[:count], vs[:count], middle, spread, floor)
            # A cell that the image's edge cuts is given the level at the centre that a whole one has.
            level[r, c] = centre + along_x * 0.5 * (x0 + cell - x1) + along_y * 0.5 * (y0 + cell - y1)
            noise[r, c] = spread if same < BLANK * count else np.nan
    return level, noise


@any_order
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


@any_order
def drift(data, expected, noise, cell, every, smooth):
    """How far a frame (H, W) lies above the expectation, from every `every`-th row.

    Returns:
        mean square of (data - expected) / noise within the clip, as part of a Gaussian's; smooth (rows, columns), filled: its
        mean in each cell with the neighbours.
    """
    h, w = data.shape
    rows, columns = smooth.shape
    level, count, columns_sum = np.zeros((rows, columns)), np.zeros((rows, columns)), np.empty((3, w), np.float32)
    squares = everywhere = 0.0
    limit = np.float32(CLIP_SIGMA)
    numbers, totals, square = columns_sum[0], columns_sum[1], columns_sum[2]
    for r in range(rows):
        columns_sum[:] = 0
        for y in range(r * cell + every // 2, min((r + 1) * cell, h), every):
            values, wanted, sigma = data[y], expected[y], noise[y]
            for x in range(w):  # sums of columns, which fill the vector unit
                z = (np.float32(values[x]) - wanted[x]) / sigma[x]
                inside = abs(z) <= limit
                numbers[x] += np.float32(1) if inside else np.float32(0)
                z = z if inside else np.float32(0)
                totals[x] += z
                square[x] += z * z
        for x in range(w):
            level[r, x // cell] += totals[x]
            count[r, x // cell] += numbers[x]
            squares += square[x]
            everywhere += numbers[x]
    for r in range(rows):  # each cell with its neighbours, by their numbers of pixels
        for c in range(columns):
            total = number = 0.0
            for j in range(max(r - 1, 0), min(r + 2, rows)):
                for i in range(max(c - 1, 0), min(c + 2, columns)):
                    weight = (2 - abs(j - r)) * (2 - abs(i - c))
                    total, number = total + weight * level[j, i], number + weight * count[j, i]
            smooth[r, c] = total / number if number > 0 else 0.0
    return squares / max(everywhere, 1.0) / INSIDE_CLIP**2
