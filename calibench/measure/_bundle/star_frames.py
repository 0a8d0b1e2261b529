"""Star frames: identified stars of many frames, an attitude of three parameters each."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry import projection
from ...geometry.rotation import matrix_from_rotvec
from ...records import Identification, Intrinsics


@dataclass(frozen=True, kw_only=True)
class StarFrames:
    """V frames of up to P stars, a `Block`.

    xy_px (V, P, 2), weight (V, P) px^-1, direction_icrs (V, P, 3); rows beyond a frame's stars have weight 0 and repeat
    its first star. rotation (V, 3, 3): v_cam = rotation @ v_icrs.
    """

    xy_px: np.ndarray
    weight: np.ndarray
    direction_icrs: np.ndarray
    rotation: np.ndarray
    own_count = 0
    pose_count = 3

    @classmethod
    def of(cls, lens: Intrinsics, found: Sequence[Identification]) -> StarFrames:
        """Frames of identified stars; weights from the spots' covariance, attitudes that fit best under the lens given.

        Raises:
            BadInput: the lens has no direction for a spot.
        """
        most = max(len(f.xy_px) for f in found)
        rows = [np.r_[0:len(f.xy_px), np.zeros(most - len(f.xy_px), int)] for f in found]
        xy = np.stack([f.xy_px[r] for f, r in zip(found, rows, strict=True)])
        icrs = np.stack([f.direction_icrs[r] for f, r in zip(found, rows, strict=True)])
        variance = np.stack([np.trace(f.covariance_px2[r], axis1=1, axis2=2) / 2 for f, r in zip(found, rows, strict=True)])
        there = np.arange(most) < np.array([[len(f.xy_px)] for f in found])
        weight = np.where(there, 1 / np.sqrt(variance), 0)
        return cls(xy_px=xy, weight=weight, direction_icrs=icrs, rotation=_attitudes(lens, xy, there, icrs))

    def to_camera(self) -> np.ndarray:
        return np.ascontiguousarray(np.moveaxis(self.rotation @ self.direction_icrs.swapaxes(1, 2), 1, 0))

    def fill(self, rows: np.ndarray, xyz: np.ndarray, by_v: tuple) -> None:
        x, y, z = xyz
        for axis, (by_x, by_y, by_z) in enumerate(by_v):
            rows[:, 0, axis] = y * by_z - z * by_y
            rows[:, 1, axis] = z * by_x - x * by_z
            rows[:, 2, axis] = x * by_y - y * by_x

    def moved(self, own: np.ndarray, poses: np.ndarray) -> StarFrames:
        return dataclasses.replace(self, rotation=matrix_from_rotvec(poses) @ self.rotation)

    def weighted(self, weight: np.ndarray) -> StarFrames:
        return dataclasses.replace(self, weight=weight)

    def take(self, views: np.ndarray | slice) -> StarFrames:
        """The block of these frames (index or mask)."""
        return StarFrames(**{f.name: getattr(self, f.name)[views] for f in dataclasses.fields(self)})


def _attitudes(lens: Intrinsics, xy_px: np.ndarray, there: np.ndarray, icrs: np.ndarray) -> np.ndarray:
    """Rotations (V, 3, 3) nearest to turning the stars into the spots' directions (Markley 1988, by SVD)."""
    v = projection.unproject(lens, xy_px.reshape(-1, 2)).reshape(icrs.shape)
    u, _, wt = np.linalg.svd((v * there[..., None]).swapaxes(1, 2) @ icrs)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ wt))[:, None]
    return u @ wt
