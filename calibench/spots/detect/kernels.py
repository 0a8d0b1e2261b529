"""Compiled: one pass over a frame against its threshold map, and the growth of a spot around each peak."""

from __future__ import annotations

from math import sqrt

import numpy as np

from ...kernels import compiled
from ..kernels import LONG

# A Gaussian of 0.85 px over 3x3 pixels: within 15 % of the best signal-to-noise for stars of 0.4 to 1.5 px.
SIDE = 0.5006
WEIGHT_SUM, WEIGHT_NORM = (1 + 2 * SIDE) ** 2, 1 + 2 * SIDE**2
SEED_SIGMA = 3.0  # a spot's brightest pixel is above this
SHARPEST = 0.85  # of the light of 3x3 pixels in one: a hot pixel or a particle, sharper than the optics of any star camera
ROWS_TOGETHER = 16  # whose thresholds a first look takes together
CELL_PX = 64  # in which the sky's drift since the threshold map was made is followed
GROW_SIGMA = 2.5  # a spot's pixels: connected to its peak and above this
CONTRAST_SIGMA, CONTRAST = 5.0, 0.1  # a second peak stands out of the saddle by this many sigma, and this part of itself
TRAIL_CONTRAST = 0.5  # in light as long as a trail's noise makes peaks: this part of itself then
LEAST_TO_JUDGE = 6  # fewer pixels tell no elongation
COLUMNS = 11  # of what grow gives
ROW_SHIFT, COLUMN_MASK = 32, (1 << 32) - 1  # a pixel on a stack: row and column in one number that is quick to part


@compiled
def fill_thresholds(expected, noise, whole, blocked, seed, lowest):
    """Fills seed (H, W) and lowest (H / ROWS_TOGETHER, W) of a threshold map; whole: the values are whole numbers. In expected
    and noise (H, W) float32 pixels that cannot be used become NaN and 1."""
    h, w = expected.shape
    lowest[:] = blocked
    for y in range(h):
        line = lowest[y // ROWS_TOGETHER]
        for x in range(w):
            usable = noise[y, x] > 0 and noise[y, x] < np.inf and abs(expected[y, x]) < np.inf
            if not usable:
                expected[y, x], noise[y, x], seed[y, x] = np.nan, 1, blocked
                continue
            top = expected[y, x] + np.float32(SEED_SIGMA) * noise[y, x]
            if whole:  # a value above the floor is above the threshold
                top = np.floor(min(max(top, np.float32(0)), np.float32(blocked - 1)))
            seed[y, x] = top
            line[x] = min(line[x], seed[y, x])


@compiled
def score_at(data, expected, noise, level, y, x):
    """Signal-to-noise of the best-matching faint star centred in pixel (x, y): sum(w r / v) / sqrt(sum(w^2 / v)) over the
    usable ones of 3x3 pixels, r = data - expected - level * noise; and the part of their light that is in the centre."""
    h, w = data.shape
    shift = level[y // CELL_PX, x // CELL_PX]
    top = bottom = light = centre = 0.0
    for j in range(max(y - 1, 0), min(y + 2, h)):
        for i in range(max(x - 1, 0), min(x + 2, w)):
            e = expected[j, i]
            if e == e:
                sigma = noise[j, i]
                r = data[j, i] - e - shift * sigma
                weight = (1.0 if i == x else SIDE) * (1.0 if j == y else SIDE)
                top += weight * r / (sigma * sigma)
                bottom += weight * weight / (sigma * sigma)
                light += max(r, 0.0)
                if i == x and j == y:
                    centre = r
    return (top / sqrt(bottom) if bottom > 0 else 0.0), (centre / light if light > 0 else 1.0)


@compiled
def _promising(data, lowest, sigma, y, x, least):
    """Whether the pixels about (x, y) may score above `least`: by thresholds that are at hand and not above the pixels' own.

    Generous by one sigma (drift, rounding, a neighbour that is not used); neighbours count as no less than expected."""
    wanted = (least - 1) * WEIGHT_NORM * sigma - WEIGHT_SUM
    total = float(data[y, x]) - float(lowest[y // ROWS_TOGETHER, x]) + SEED_SIGMA * sigma
    if total > wanted:  # most pixels of a star
        return True
    total = 0.0
    for j in range(3):
        line = (y + j - 1) // ROWS_TOGETHER
        for i in range(3):
            excess = float(data[y + j - 1, x + i - 1]) - float(lowest[line, x + i - 1]) + SEED_SIGMA * sigma
            total += (1.0 if j == 1 else SIDE) * (1.0 if i == 1 else SIDE) * max(excess, 0.0)
    return total > wanted


@compiled
def _excess(data, seed, y, x):
    return float(data[y, x]) - float(seed[y, x])


@compiled
def _highest(data, seed, y, x):
    """Whether (x, y) is above its threshold, and farthest of its 3x3; of equal ones the first."""
    own = _excess(data, seed, y, x)
    if own <= 0:
        return False
    # The four sides first: one of them is brighter, nearly always.
    if (_excess(data, seed, y, x - 1) >= own or _excess(data, seed, y, x + 1) > own
            or _excess(data, seed, y - 1, x) >= own or _excess(data, seed, y + 1, x) > own):
        return False
    return not (_excess(data, seed, y - 1, x - 1) >= own or _excess(data, seed, y - 1, x + 1) >= own
                or _excess(data, seed, y + 1, x - 1) > own or _excess(data, seed, y + 1, x + 1) > own)


@compiled
def scan(data, seed, lowest, expected, noise, coarse, level, least, above, eight, waiting, peaks):
    """Peaks of a frame: pixels above their seed threshold, the highest of their 3x3, where the matched filter gives
    more than `least` sigma and the light is not all in one pixel.

    data, seed: (H, W) of one type; seed is expected + SEED_SIGMA * noise, or beyond reach where a pixel is not used. lowest:
    (H / ROWS_TOGETHER, W), the least seed of each column's pixels of ROWS_TOGETHER rows: it stays in the cache, so that the
    frame alone is read from memory. expected, noise: (H, W) float32, expected NaN where a pixel is not used. coarse, level:
    cells of CELL_PX: the noise in DN, and the sky's drift since in sigma. Room to work in: above (W or more, a multiple of 64)
    bool, all False from W on; eight: the same as uint64; waiting (2, W + 8) int64.

    Returns:
        number N of peaks; peaks (most, 3): rows, columns, scores, filled in reading order.
    """
    h, w = data.shape
    waits = count = 0
    for y in range(h):
        row, threshold = data[y], lowest[y // ROWS_TOGETHER]
        for x in range(w):  # this loop alone touches every pixel; it compiles to vector compares
            above[x] = row[x] > threshold[x]
        now, before = y % 2, 1 - y % 2
        ready, waits = waits, 0
        for k in range(0, len(eight), 8):
            if (eight[k] | eight[k + 1] | eight[k + 2] | eight[k + 3]
                    | eight[k + 4] | eight[k + 5] | eight[k + 6] | eight[k + 7]):
                for m in range(k, k + 8):
                    if eight[m]:
                        for x in range(8 * m, 8 * m + 8):  # without a branch that nobody could predict
                            waiting[now, waits] = x
                            waits += above[x]
        for n in range(ready if y > 1 else 0):  # of the row before: its neighbours are in the cache by now
            x = waiting[before, n]
            if (0 < x < w - 1 and _promising(data, lowest, coarse[(y - 1) // CELL_PX, x // CELL_PX], y - 1, x, least)
                    and _highest(data, seed, y - 1, x)):
                score, sharpness = score_at(data, expected, noise, level, y - 1, x)
                if score > least and sharpness < SHARPEST and count < len(peaks):
                    peaks[count, 0], peaks[count, 1], peaks[count, 2] = y - 1, x, score
                    count += 1
    return count


@compiled
def _stands_out(data, expected, noise, level, y, x, score, other_y, other_x, gain, contrast):
    """Whether a peak is separated by a real saddle from a brighter one of the same spot."""
    steps = max(abs(other_y - y), abs(other_x - x))
    lowest = score
    for k in range(1, steps):
        j, i = round(y + (other_y - y) * k / steps), round(x + (other_x - x) * k / steps)
        lowest = min(lowest, score_at(data, expected, noise, level, j, i)[0])
    sigma = noise[y, x]
    shot = gain * max(data[y, x] - expected[y, x], 0.0) / (sigma * sigma)
    return score - lowest > max(CONTRAST_SIGMA * sqrt(1.0 + shot), contrast * score)


@compiled
def _flood(data, expected, noise, level, labels, lowest, owner, label, y, x, stack, largest):
    """Labels the pixels connected to (x, y); their number; beyond `largest` the rest is left, and what
    touches such light (owner -1) belongs to it."""
    h, w = data.shape
    sigmas = GROW_SIGMA + level[y // CELL_PX, x // CELL_PX]
    stack[0] = (y << ROW_SHIFT) | x
    labels[y, x] = label
    count, done = 1, 0
    while done < count and count <= largest:
        j0, i0 = stack[done] >> ROW_SHIFT, stack[done] & COLUMN_MASK
        done += 1
        for j in range(max(j0 - 1, 0), min(j0 + 2, h)):
            for i in range(max(i0 - 1, 0), min(i0 + 2, w)):
                there = labels[j, i]
                if there == label:
                    continue
                if there >= lowest:
                    if owner[there - lowest] < 0:
                        return largest + 1
                    continue
                # An expectation of NaN, a pixel that is not used, compares as false.
                if data[j, i] - expected[j, i] > sigmas * noise[j, i]:
                    labels[j, i] = label
                    stack[count] = (j << ROW_SHIFT) | i
                    count += 1
    return count


@compiled
def _near(labels, y, x, stack):
    """Puts the pixels of 3x3 about (x, y) that belong to its light on the stack; their number."""
    h, w = labels.shape
    count = 0
    for j in range(max(y - 1, 0), min(y + 2, h)):
        for i in range(max(x - 1, 0), min(x + 2, w)):
            if labels[j, i] == labels[y, x]:
                stack[count] = (j << ROW_SHIFT) | i
                count += 1
    return count


@compiled
def _shape(data, expected, noise, level, stack, count, y, x, row):
    """Fills x, y, peak, flux, pixels, elongation of one spot from its pixels; the place is the mass of its brighter half."""
    peak, shift = 0.0, level[y // CELL_PX, x // CELL_PX]
    for k in range(count):
        j, i = stack[k] >> ROW_SHIFT, stack[k] & COLUMN_MASK
        peak = max(peak, data[j, i] - expected[j, i] - shift * noise[j, i])
    flux = mx = my = core = cx = cy = sxx = syy = sxy = 0.0
    for k in range(count):
        j, i = stack[k] >> ROW_SHIFT, stack[k] & COLUMN_MASK
        r = max(data[j, i] - expected[j, i] - shift * noise[j, i], 1e-6)
        dx, dy = float(i - x), float(j - y)
        flux, mx, my = flux + r, mx + r * dx, my + r * dy
        sxx, syy, sxy = sxx + r * dx * dx, syy + r * dy * dy, sxy + r * dx * dy
        if 2 * r > peak:
            core, cx, cy = core + r, cx + r * dx, cy + r * dy
    mx, my = mx / flux, my / flux
    sxx, syy, sxy = sxx / flux - mx * mx + 1 / 12, syy / flux - my * my + 1 / 12, sxy / flux - mx * my
    half, root = (sxx + syy) / 2, sqrt(((sxx - syy) / 2) ** 2 + sxy * sxy)
    row[0], row[1] = (x + cx / core, y + cy / core) if core > 0 else (float(x), float(y))
    row[2], row[3], row[4] = peak, flux, count
    row[5] = sqrt((half + root) / max(half - root, 1e-3)) if count >= LEAST_TO_JUDGE else 1.0


@compiled
def grow(data, expected, noise, level, peaks, gain, labels, lowest, stack, owner, elongation, out):
    """Spots around peaks (N, 3), rows, columns, scores, brightest first. Room to work in: labels (H, W) int32, all below
    `lowest`, afterwards below lowest + N; stack int64, 16 longer than the largest number of pixels of connected light; owner
    int64 and elongation (N,).

    Returns:
        number of spots; out (N, COLUMNS), filled: x, y, peak DN, flux DN, pixels, elongation, peak x, peak y, score, blend
        (1 or 0), row of the first spot of the same connected light. A further peak within the light of a brighter one is a spot
        of its own where a saddle separates them, both marked as blend; else it is that one's wing. Connected light of more
        pixels than the largest is no star and is left out.
    """
    count = labelled = 0
    largest = len(stack) - 16
    # owner: of a label, its first spot, -1 where it is no star; elongation: of the whole light, where two share it as well
    for n in range(len(peaks)):
        y, x, score = int(peaks[n, 0]), int(peaks[n, 1]), peaks[n, 2]
        if labels[y, x] < lowest:
            size = _flood(data, expected, noise, level, labels, lowest, owner, lowest + labelled, y, x, stack, largest)
            owner[labelled] = count if size <= largest else -1
            labelled += 1
            if size > largest:
                continue
            _shape(data, expected, noise, level, stack, size, y, x, out[count])
            elongation[count] = out[count, 5]
            out[count, 6], out[count, 7], out[count, 8], out[count, 10] = x, y, score, count
            count += 1
            continue
        first = owner[labels[y, x] - lowest]
        if first < 0:
            continue
        alone, contrast = True, TRAIL_CONTRAST if elongation[first] > LONG else CONTRAST
        for k in range(first, count):
            if out[k, 10] == first and alone:
                alone = _stands_out(data, expected, noise, level, y, x, score, int(out[k, 7]), int(out[k, 6]), gain,
                                     contrast)
        if alone:
            near = _near(labels, y, x, stack)
            _shape(data, expected, noise, level, stack, near, y, x, out[count])
            if out[first, 9] == 0:  # its place was that of all the light
                j, i = int(out[first, 7]), int(out[first, 6])
                near = _near(labels, j, i, stack)
                _shape(data, expected, noise, level, stack, near, j, i, out[first])
            out[count, 6], out[count, 7], out[count, 8], out[count, 10] = x, y, score, first
            out[count, 5] = out[first, 5] = 1.0
            out[count, 9] = out[first, 9] = 1.0
            count += 1
    return count
