"""Sums over frames, pixel by pixel: integers throughout, so that the order of the frames and of merging cannot matter.

Images are flat (H * W,) here. Blocks of the sums stay in the cache while the frames of a batch pass over them.
"""

from __future__ import annotations

import numpy as np

from ..kernels import any_order, compiled

BLOCK = 2048


@compiled
def add_frames(frames, count, weights, total, squares, weighted):
    """Add the first `count` of a tuple of frames x: x to total (int32), x^2 to squares (uint32 or int64), weight x to weighted
    (int32 or int64).

    weights: (count or more,) int32, one a frame. Values are not shifted: subtracting costs a third of the time, and integers
    lose nothing by being large.
    """
    for low in range(0, total.size, BLOCK):
        high = min(total.size, low + BLOCK)
        t, q, w = total[low:high], squares[low:high], weighted[low:high]
        f = 0
        while f + 4 <= count:  # four a turn: the sums are loaded and stored once for them
            a, b, c, d = frames[f][low:high], frames[f + 1][low:high], frames[f + 2][low:high], frames[f + 3][low:high]
            wa, wb = np.int64(weights[f]), np.int64(weights[f + 1])
            wc, wd = np.int64(weights[f + 2]), np.int64(weights[f + 3])
            for i in range(high - low):
                xa, xb, xc, xd = np.int64(a[i]), np.int64(b[i]), np.int64(c[i]), np.int64(d[i])
                t[i] += xa + xb + xc + xd
                q[i] += xa * xa + xb * xb + xc * xc + xd * xd
                w[i] += wa * xa + wb * xb + wc * xc + wd * xd
            f += 4
        while f < count:
            a, wa = frames[f][low:high], np.int64(weights[f])
            for i in range(high - low):
                x = np.int64(a[i])
                t[i] += x
                q[i] += x * x
                w[i] += wa * x
            f += 1


@compiled
def steady_squares(total, squares, weighted, count, weight_sum, dn_per_weight, spread_dn2, own_slope, out):
    """Each pixel's sum of squared deviations with its part common to all pixels taken out, into out (float32).

    spread_dn2: sum of squared deviations of the weights, as DN. own_slope: the common part is the pixel's regression on the
    weights; else every pixel follows them one to one.
    """
    for i in range(total.size):
        own = np.float64(count * np.int64(squares[i]) - np.int64(total[i]) * np.int64(total[i])) / count
        cross = (np.float64(weighted[i]) - weight_sum * np.float64(total[i]) / count) * dn_per_weight
        out[i] = max(own - cross * cross / spread_dn2, 0.0) if own_slope else max(own - 2 * cross + spread_dn2, 0.0)


@compiled
def band_sums(data, band_px, bands):
    """Add up the rows of data (H, W) in bands of `band_px` rows, into bands (B, W); the last band takes the rows left over.

    Gives the largest value of the data, and how many pixels have it; a row is looked at three times while it is in the cache.
    """
    largest, count = data[0, 0], 0
    for y in range(data.shape[0]):
        line, band = data[y], bands[min(y // band_px, bands.shape[0] - 1)]
        most = line[0]
        for x in range(data.shape[1]):
            band[x] += line[x]
        for x in range(data.shape[1]):
            most = max(most, line[x])
        if most > largest:
            largest, count = most, 0
        if most == largest:
            for x in range(data.shape[1]):
                count += line[x] == most
    return largest, count


@any_order
def rest_moments(image, columns, rows):
    """Sums of r^2 and r^4 over image (H, W) float32, r: pixel minus its column's (W,) and its row's (H,) value, float64."""
    second, fourth = 0.0, 0.0
    for y in range(image.shape[0]):
        line, row = image[y], rows[y]
        for x in range(image.shape[1]):
            r = np.float64(line[x]) - columns[x] - row
            second += r * r
            fourth += (r * r) * (r * r)
    return second, fourth
