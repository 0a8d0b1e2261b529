"""Compiled: the map applied to windows of a raw frame, and the noise that it predicts there."""

from __future__ import annotations

import numpy as np

from ..kernels import compiled


@compiled
def correct_windows(data, centre_xy, radius, offset, dark, response, defects, measured, linear, saturation, saturated, signal,
                    flags):
    """Fills signal (N, n, n) float32 and flags (N, n, n) uint16 of windows about integer centres (N, 2) of data (H, W).

    offset, dark, response: (H, W) float32 each, or (1, 1) where one value holds everywhere. defects: (H, W) uint16 or (1, 1).
    measured, linear: (P,) float32, points of the linearity curve, P 0 without one. saturation: the value from which on a pixel
    gets the flag `saturated`. Beyond the frame's edge signal is NaN and flags 0.
    """
    h, w = data.shape
    side = 2 * radius + 1
    oy, dy, ry, fy = len(offset) > 1, len(dark) > 1, len(response) > 1, len(defects) > 1
    for n in range(len(centre_xy)):
        for j in range(side):
            for i in range(side):
                x, y = centre_xy[n, 0] - radius + i, centre_xy[n, 1] - radius + j
                if x < 0 or y < 0 or x >= w or y >= h:
                    signal[n, j, i], flags[n, j, i] = np.nan, 0
                    continue
                charge = np.float32(data[y, x]) - offset[y * oy, x * oy]
                if len(measured):
                    k = 0
                    while k < len(measured) - 2 and charge > measured[k + 1]:
                        k += 1
                    slope = (linear[k + 1] - linear[k]) / (measured[k + 1] - measured[k])
                    charge = linear[k] + slope * (charge - measured[k])
                signal[n, j, i] = (charge - dark[y * dy, x * dy]) / response[y * ry, x * ry]
                flags[n, j, i] = defects[y * fy, x * fy] | (saturated if data[y, x] >= saturation else 0)


@compiled
def sky_variance(corner_xy, background, read_variance, dark, response, measured, linear, gain, out):
    """Fills out (N, n, n) float32: variance of corrected pixels, DN^2, of windows at corner_xy (N, 2) under a sky of background
    (N,): (slope^2 read_variance + gain (background response + dark)) / response^2; 1 beyond the edge. Arrays as in
    `correct_windows`."""
    h, w = read_variance.shape
    dy, ry = len(dark) > 1, len(response) > 1
    for n in range(len(corner_xy)):
        for j in range(out.shape[1]):
            for i in range(out.shape[2]):
                x, y = corner_xy[n, 0] + i, corner_xy[n, 1] + j
                out[n, j, i] = 1
                if x < 0 or y < 0 or x >= w or y >= h:
                    continue
                responds = response[y * ry, x * ry]
                charge, slope = background[n] * responds + dark[y * dy, x * dy], 1.0
                if len(measured):
                    k = 0
                    while k < len(measured) - 2 and charge > linear[k + 1]:
                        k += 1
                    slope = (linear[k + 1] - linear[k]) / (measured[k + 1] - measured[k])
                out[n, j, i] = (slope * slope * read_variance[y, x] + gain * max(charge, 0.0)) / (responds * responds)
