"""Boards: views of one flat board, a pose of six parameters each, and the bow that all views share.

Bow: the board is a shallow dish, z = bow_x (1 - a^2) + bow_y (1 - b^2) with a, b from -1 to 1 across the points; z points
away from the camera.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ...geometry.rotation import matrix_from_rotvec, rotvec_from_matrix


def board_points_mm(board: tuple[int, int], square_mm: float) -> np.ndarray:
    """Corners (P, 3) of a flat board, row by row, mm."""
    columns, rows = np.meshgrid(np.arange(board[0]), np.arange(board[1]))
    return np.stack([columns.ravel(), rows.ravel(), np.zeros(columns.size)], -1) * float(square_mm)


def bow_shape(points_mm: np.ndarray) -> np.ndarray:
    """(P, 2) height of the board for a bow of 1 in each axis."""
    low, high = points_mm[:, :2].min(axis=0), points_mm[:, :2].max(axis=0)
    return 1 - ((2 * points_mm[:, :2] - low - high) / (high - low)) ** 2


@dataclass(frozen=True, kw_only=True)
class Boards:
    """V views of a board of P points, a `Block`.

    xy_px (V, P, 2), weight (V, P) px^-1, points_mm (P, 3) of the flat board. rotation (V, 3, 3), translation_mm (V, 3):
    v_cam = rotation @ point + translation. bow_mm (2,); a flat board stays so unless bow_free.
    """

    xy_px: np.ndarray
    weight: np.ndarray
    points_mm: np.ndarray
    rotation: np.ndarray
    translation_mm: np.ndarray
    bow_mm: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(2))
    bow_free: bool = False
    pose_count = 6

    @property
    def own_count(self) -> int:
        return 2 if self.bow_free else 0

    def to_camera(self) -> np.ndarray:
        shaped = self.points_mm.copy()
        shaped[:, 2] += bow_shape(self.points_mm) @ self.bow_mm
        by_axis = self.rotation.swapaxes(0, 1)
        turned = (by_axis.reshape(-1, 3) @ shaped.T).reshape(3, len(self.rotation), -1)
        turned += self.translation_mm.T[..., None]
        return turned

    def fill(self, rows: np.ndarray, xyz: np.ndarray, by_v: tuple) -> None:
        own = self.own_count
        normal = self.rotation[:, :, 2, None]
        shape = bow_shape(self.points_mm).T
        x, y, z = xyz - self.translation_mm.T[..., None]
        for axis, (by_x, by_y, by_z) in enumerate(by_v):
            if own:
                height = by_x * normal[:, 0] + by_y * normal[:, 1] + by_z * normal[:, 2]
                np.multiply(height[:, None], shape, out=rows[:, :own, axis])
            np.subtract(y * by_z, z * by_y, out=rows[:, own, axis])
            np.subtract(z * by_x, x * by_z, out=rows[:, own + 1, axis])
            np.subtract(x * by_y, y * by_x, out=rows[:, own + 2, axis])
            for i, derivative in enumerate((by_x, by_y, by_z), start=own + 3):
                rows[:, i, axis] = derivative

    def moved(self, own: np.ndarray, poses: np.ndarray) -> Boards:
        return dataclasses.replace(self, rotation=matrix_from_rotvec(poses[:, :3]) @ self.rotation,
                                   translation_mm=self.translation_mm + poses[:, 3:],
                                   bow_mm=self.bow_mm + own if len(own) else self.bow_mm)

    def weighted(self, weight: np.ndarray) -> Boards:
        return dataclasses.replace(self, weight=weight)

    def take(self, views: np.ndarray | slice) -> Boards:
        """The block of these views (index or mask)."""
        return dataclasses.replace(self, **{name: getattr(self, name)[views]
                                            for name in ("xy_px", "weight", "rotation", "translation_mm")})

    @property
    def poses(self) -> np.ndarray:
        """(V, 6): rotation vector in rad, translation in mm."""
        return np.concatenate([[rotvec_from_matrix(r) for r in self.rotation], self.translation_mm], axis=1)
