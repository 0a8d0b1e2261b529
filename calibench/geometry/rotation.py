"""Rotations: quaternions (scalar last, Hamilton), matrices, rotation vectors.

`matrix_from_quaternion(q) @ v` rotates v the way SciPy's Rotation does. The attitude papers' quaternion (QUEST) is the
conjugate of this one; it is converted once, where it is made (stars/attitude).
"""

from __future__ import annotations

import math

import numpy as np


def matrix_from_quaternion(q: np.ndarray) -> np.ndarray:
    """(..., 4) unit quaternion (x, y, z, w) -> (..., 3, 3) matrix; q and -q give the same."""
    q = np.asarray(q, float)
    x, y, z, w = q.tolist() if q.ndim == 1 else np.moveaxis(q, -1, 0)  # floats: numpy costs more than it does here
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    return np.array(rows) if q.ndim == 1 else np.stack([np.stack(row, -1) for row in rows], -2)


def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """(3, 3) rotation -> (4,) unit quaternion with w >= 0.

    The largest of the four components is computed first (Shepperd 1978), so no rotation loses digits.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.asarray(matrix, float).tolist()  # floats: numpy costs more than it does here
    t = xx + yy + zz
    squares = (1 + 2 * xx - t, 1 + 2 * yy - t, 1 + 2 * zz - t, 1 + t)  # 4 q_i^2
    i = squares.index(max(squares))
    x_w, y_w, z_w, x_y, x_z, y_z = zy - yz, xz - zx, yx - xy, xy + yx, xz + zx, yz + zy
    row = ((squares[0], x_y, x_z, x_w), (x_y, squares[1], y_z, y_w), (x_z, y_z, squares[2], z_w),
           (x_w, y_w, z_w, squares[3]))[i]
    length = math.copysign(math.hypot(*row), row[3])
    return np.array(row) / length


def skew(v: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3) with skew(v) @ u = v x u."""
    v = np.asarray(v, float)
    if v.ndim == 1:
        x, y, z = v.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    x, y, z = np.moveaxis(v, -1, 0)
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2)


def matrix_from_rotvec(rotvec: np.ndarray) -> np.ndarray:
    """(..., 3) rotation vector, rad -> (..., 3, 3) matrix (Rodrigues; series near zero)."""
    r = np.asarray(rotvec, float)
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1 - angle**2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    k = skew(r)
    return np.eye(3) + a * k + b * (k @ k)


def rotvec_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """(3, 3) rotation -> (3,) rotation vector, rad, angle in [0, pi]."""
    q = quaternion_from_matrix(matrix)
    sine = math.hypot(*q[:3].tolist())
    angle = 2 * math.atan2(sine, q[3])
    return q[:3] * (angle / sine if sine > 1e-12 else 2.0)


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """The proper rotation nearest (Frobenius) to a (3, 3) matrix."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
