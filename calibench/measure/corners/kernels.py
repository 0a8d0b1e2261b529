"""One Gauss-Newton step towards a centre of symmetry, for each point of a view in one pass over its window."""

from __future__ import annotations

import numpy as np

from ...kernels import compiled


@compiled
def odd_parts(patch, fraction, sigma_px, room_px, inverse, bend, half, weight, gradient, odd, sums):
    """What is not the same after half a turn, and how a step changes it.

    Args:
        patch: (P, m, m) float32, light around each point's whole pixel. fraction: (P, 2) px of the point beyond it. sigma_px:
            of the Gaussian under which the light is sampled on a lattice of n x n pixels about the point. room_px: (P, 2)
            int64; farther off a sample or its partner leaves the image. inverse: (P, 2, 2) from px to spacings. bend: (P, 2, 3)
            px by uu, uv, vv. half: (P,) half width of the window, spacings.
        weight, odd: (P, n, n) float32, n odd, filled: window, and odd part of the light less what the bend makes odd.
        gradient: (P, 2, n, n) float32, filled: the light's derivatives by x and y, of its even part.
        sums: (P, 5), filled: weighted sums of gradient products xx, xy, yy, and of gradient times odd part, x and y.
    """
    count, n = odd.shape[:2]
    m = patch.shape[1]
    taps, reach = m - n + 1, n // 2
    across, by_x = np.empty((m, n), np.float32), np.empty((m, n), np.float32)
    light = np.empty((3, n, n), np.float32)
    gauss, slope = np.empty((2, taps), np.float32), np.empty((2, taps), np.float32)
    for p in range(count):
        for axis in range(2):
            total = 0.0
            for k in range(taps):
                total += np.exp(-0.5 * ((k - taps // 2 - fraction[p, axis]) / sigma_px) ** 2)
            for k in range(taps):
                t = k - taps // 2 - fraction[p, axis]
                gauss[axis, k] = np.exp(-0.5 * (t / sigma_px) ** 2) / total
                slope[axis, k] = t / sigma_px**2 * gauss[axis, k]
        across[:], by_x[:], light[:] = 0, 0, 0
        for row in range(m):
            a, b = across[row], by_x[row]
            for k in range(taps):
                g, d, source = gauss[0, k], slope[0, k], patch[p, row, k:]
                for column in range(n):
                    a[column] += g * source[column]
                    b[column] += d * source[column]
        for row in range(n):
            a, b, c = light[0, row], light[1, row], light[2, row]
            for k in range(taps):
                g, d, source, slopes = gauss[1, k], slope[1, k], across[row + k], by_x[row + k]
                for column in range(n):
                    a[column] += g * source[column]
                    b[column] += g * slopes[column]
                    c[column] += d * source[column]
        xx = xy = yy = x_odd = y_odd = 0.0
        for row in range(reach + 1):  # the other half of the lattice is this one's partner
            for column in range(n if row < reach else reach + 1):
                i, j = n - 1 - row, n - 1 - column
                dx, dy = column - reach, row - reach
                u = inverse[p, 0, 0] * dx + inverse[p, 0, 1] * dy
                v = inverse[p, 1, 0] * dx + inverse[p, 1, 1] * dy
                gx = (light[1, row, column] - light[1, i, j]) / 2
                gy = (light[2, row, column] - light[2, i, j]) / 2
                left = (light[0, row, column] - light[0, i, j]) / 2
                left += gx * (bend[p, 0, 0] * u * u + bend[p, 0, 1] * u * v + bend[p, 0, 2] * v * v)
                left += gy * (bend[p, 1, 0] * u * u + bend[p, 1, 1] * u * v + bend[p, 1, 2] * v * v)
                w = 0.0
                if abs(u) < half[p] and abs(v) < half[p] and abs(dx) <= room_px[p, 0] and abs(dy) <= room_px[p, 1]:
                    w = (np.cos(np.pi / 2 * u / half[p]) * np.cos(np.pi / 2 * v / half[p])) ** 2
                gradient[p, 0, row, column], gradient[p, 0, i, j] = gx, -gx
                gradient[p, 1, row, column], gradient[p, 1, i, j] = gy, -gy
                odd[p, row, column], odd[p, i, j] = left, -left
                weight[p, row, column] = weight[p, i, j] = w
                both = w if row == i and column == j else 2 * w
                xx += both * gx * gx
                xy += both * gx * gy
                yy += both * gy * gy
                x_odd += both * gx * left
                y_odd += both * gy * left
        sums[p] = xx, xy, yy, x_odd, y_odd
