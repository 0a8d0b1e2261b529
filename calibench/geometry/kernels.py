"""Compiled loops of geometry: small rotations and fits, lenses bent and straightened; bricks of the sky wing's kernels."""

from __future__ import annotations

import numpy as np

from ..kernels import compiled


@compiled
def solve3(a, b):
    """a (3, 3) symmetric, b (3,): (inverse of a, solution of a x = b, determinant)."""
    inverse = np.empty((3, 3))
    inverse[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    inverse[0, 1] = inverse[1, 0] = a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]
    inverse[0, 2] = inverse[2, 0] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    inverse[1, 1] = a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]
    inverse[1, 2] = inverse[2, 1] = a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]
    inverse[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    determinant = a[0, 0] * inverse[0, 0] + a[0, 1] * inverse[1, 0] + a[0, 2] * inverse[2, 0]
    inverse /= determinant
    x = np.empty(3)
    for i in range(3):
        x[i] = inverse[i, 0] * b[0] + inverse[i, 1] * b[1] + inverse[i, 2] * b[2]
    return inverse, x, determinant


@compiled
def triad(a1, a2, b1, b2, out):
    """Rotation with a = R b for two pairs of directions (Black 1964), into out (3, 3); False where they are parallel."""
    a, b = np.empty((3, 3)), np.empty((3, 3))
    for frame, first, second in ((a, a1, a2), (b, b1, b2)):
        length = 0.0
        for i in range(3):
            frame[0, i] = first[i]
            frame[1, i] = first[(i + 1) % 3] * second[(i + 2) % 3] - first[(i + 2) % 3] * second[(i + 1) % 3]
            length += frame[1, i] ** 2
        if length < 1e-14:
            return False
        for i in range(3):
            frame[1, i] /= np.sqrt(length)
        for i in range(3):
            frame[2, i] = frame[0, (i + 1) % 3] * frame[1, (i + 2) % 3] - frame[0, (i + 2) % 3] * frame[1, (i + 1) % 3]
    for i in range(3):
        for j in range(3):
            out[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]
    return True


@compiled
def turned(matrix, v, out):
    """matrix (3, 3) @ v (3,) into out."""
    for i in range(3):
        out[i] = matrix[i, 0] * v[0] + matrix[i, 1] * v[1] + matrix[i, 2] * v[2]


@compiled
def turn_by(d, matrix):
    """exp([d]x) @ matrix into matrix, for a small rotation vector d (Rodrigues' vector d/2, exact rotation by about d)."""
    squared = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) / 4
    for column in range(3):
        x, y, z = matrix[0, column], matrix[1, column], matrix[2, column]
        cx, cy, cz = d[1] * z - d[2] * y, d[2] * x - d[0] * z, d[0] * y - d[1] * x
        ccx, ccy, ccz = d[1] * cz - d[2] * cy, d[2] * cx - d[0] * cz, d[0] * cy - d[1] * cx
        matrix[0, column] = x + (cx + ccx / 2) / (1 + squared)
        matrix[1, column] = y + (cy + ccy / 2) / (1 + squared)
        matrix[2, column] = z + (cz + ccz / 2) / (1 + squared)


@compiled
def fit_rotation(camera, sky, weight, matrix):
    """One Gauss-Newton step of Wahba's problem from matrix (3, 3), in place: covariance (3, 3), rad^2 in camera axes."""
    normal, gradient, p = np.zeros((3, 3)), np.zeros(3), np.empty(3)
    for m in range(len(camera)):
        turned(matrix, sky[m], p)
        v, w = camera[m], weight[m]
        for i in range(3):
            gradient[i] += w * (p[(i + 1) % 3] * v[(i + 2) % 3] - p[(i + 2) % 3] * v[(i + 1) % 3])
            normal[i, i] += w
            for j in range(3):
                normal[i, j] -= w * p[i] * p[j]
    covariance, step, _ = solve3(normal, gradient)
    turn_by(step, matrix)
    return covariance


@compiled
def turn_variance(covariance, v):
    """Variance, rad^2, of one axis (the worse at most twice it) of direction v when the attitude has this covariance."""
    trace = covariance[0, 0] + covariance[1, 1] + covariance[2, 2]
    along = 0.0
    for i in range(3):
        for j in range(3):
            along += v[i] * covariance[i, j] * v[j]
    # |d x v|^2 averages to trace - ... : E|d x v|^2 = trace(C) |v|^2 - v' C v
    return (trace - along) / 2


@compiled
def bend_rational(k, x, y):
    """Tangents x, y through OpenCV's rational lens with thin prism, k (12,): x', y' and the four slopes (see _rational)."""
    u = x * x + y * y
    n, d = 1 + u * (k[0] + u * (k[1] + u * k[4])), 1 + u * (k[5] + u * (k[6] + u * k[7]))
    g = n / d
    dg = 2 * ((k[0] + u * (2 * k[1] + 3 * u * k[4])) - g * (k[5] + u * (2 * k[6] + 3 * u * k[7]))) / d
    xd = x * g + 2 * k[2] * x * y + k[3] * (u + 2 * x * x) + u * (k[8] + u * k[9])
    yd = y * g + k[2] * (u + 2 * y * y) + 2 * k[3] * x * y + u * (k[10] + u * k[11])
    of_x, of_y = 2 * (k[8] + 2 * u * k[9]), 2 * (k[10] + 2 * u * k[11])
    cross = x * y * dg + 2 * (k[2] * x + k[3] * y)
    xx = g + x * x * dg + 2 * k[2] * y + 6 * k[3] * x + x * of_x
    yy = g + y * y * dg + 6 * k[2] * y + 2 * k[3] * x + y * of_y
    return xd, yd, xx, cross + y * of_x, cross + x * of_y, yy


@compiled
def unproject(camera, k, fisheye, fold, xy):
    """Raw pixels (N, 2) -> unit directions (N, 3) in camera axes; NaN where there is none.

    camera (6,): fx, fy, cx, cy, -1 for a mirrored camera, else 1, and skew. k (12,): terms in OpenCV's order, zero where a
    model lacks them (a fisheye has four). fold: radius (fisheye: angle) up to which the lens does not fold.
    """
    out = np.empty((len(xy), 3))
    for i in range(len(xy)):
        yd = (xy[i, 1] - camera[3]) / camera[1]
        xd = (xy[i, 0] - camera[2] - camera[5] * yd) / camera[0]
        h = np.sqrt(xd * xd + yd * yd)
        if fisheye:
            t, low, high = min(h, 0.95 * fold), 0.0, fold
            for _ in range(60):  # Newton, halving where it leaves the bracket
                u = t * t
                at = t * (1 + u * (k[0] + u * (k[1] + u * (k[2] + u * k[3])))) - h
                low, high = (t, high) if at < 0 else (low, t)
                moved = t - at / (1 + u * (3 * k[0] + u * (5 * k[1] + u * (7 * k[2] + u * 9 * k[3]))))
                if not low <= moved <= high:
                    moved = (low + high) / 2
                if abs(moved - t) < 1e-15:
                    break
                t = moved
            good = abs(at) < 1e-9
            x, y, z = np.sin(t) * xd / max(h, 1e-300), np.sin(t) * yd / max(h, 1e-300), np.cos(t)
        else:
            shrink = min(1.0, 0.95 * fold / max(h, 1e-300))  # inside the fold, or Newton may leave through it
            x, y, z, good = xd * shrink, yd * shrink, 1.0, False
            for _ in range(20):
                at_x, at_y, xx, by_y, by_x, yy = bend_rational(k, x, y)
                ex, ey = xd - at_x, yd - at_y
                if abs(ex) + abs(ey) < 1e-13:
                    good = True
                    break
                determinant = xx * yy - by_y * by_x
                x += (yy * ex - by_y * ey) / determinant
                y += (xx * ey - by_x * ex) / determinant
            good = good and x * x + y * y < fold * fold
        length = np.sqrt(x * x + y * y + z * z) if good else np.nan
        out[i, 0], out[i, 1], out[i, 2] = camera[4] * x / length, y / length, z / length
    return out


@compiled
def direction_sigma(errors, width, height, xy, covariance_px2, model_sd_px):
    """Standard deviation (N,), rad, of one axis of the directions of spots at xy (N, 2).

    errors (rows, columns, 2): on a grid over the image, (rad per px)^2 and the lens's own variance; between nodes, bilinear.
    """
    rows, columns, _ = errors.shape
    out = np.empty(len(xy))
    for n in range(len(xy)):
        x = min(max(xy[n, 0] / (width - 1), 0.0), 1.0) * (columns - 1)
        y = min(max(xy[n, 1] / (height - 1), 0.0), 1.0) * (rows - 1)
        i, j = min(int(x), columns - 2), min(int(y), rows - 2)
        a, b = x - i, y - j
        spot = (covariance_px2[n, 0, 0] + covariance_px2[n, 1, 1]) / 2 + model_sd_px**2
        total = 0.0
        for weight, at in (((1 - a) * (1 - b), errors[j, i]), (a * (1 - b), errors[j, i + 1]),
                           ((1 - a) * b, errors[j + 1, i]), (a * b, errors[j + 1, i + 1])):
            total += weight * (spot * at[0] + at[1])
        out[n] = np.sqrt(total)
    return out


@compiled
def factor_definite(a):
    """Cholesky factor of a symmetric positive definite a (n, n), into its lower half, which alone is read. False: not one."""
    for i in range(len(a)):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            if i == j:
                if not total > 0:
                    return False
                a[i, i] = np.sqrt(total)
            else:
                a[i, j] = total / a[j, j]
    return True


@compiled
def solve_factored(factor, b):
    """a x = b with a's factor from `factor_definite`; x into b."""
    n = len(b)
    for i in range(n):
        for k in range(i):
            b[i] -= factor[i, k] * b[k]
        b[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= factor[k, i] * b[k]
        b[i] /= factor[i, i]


@compiled
def solve_definite(a, b):
    """a x = b for a symmetric positive definite a (n, n), of which the lower half is read; x into b. False: not definite."""
    if not factor_definite(a):
        return False
    solve_factored(a, b)
    return True


@compiled
def inverse_of_first_two(factor, column):
    """xx, yy, xy of the inverse of a matrix with that factor; column (n,) is overwritten."""
    column[:] = 0.0
    column[0] = 1.0
    solve_factored(factor, column)
    xx, xy = column[0], column[1]
    column[:] = 0.0
    column[1] = 1.0
    solve_factored(factor, column)
    return xx, column[1], xy
