"""A checkerboard before the simulated camera: where its corners fall, and its picture through the distorting lens.

Board axes: origin at the first inner corner, x along the columns, y along the rows, z into the board. The lens has one
aperture: a board is blurred by the PSF that stars have, and a corner stands where the centre of mass of a point's light would.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from ..errors import BadInput
from ..geometry.projection import project, unproject
from ..geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from .camera import SimulatedCamera
from .psf import Aberrations, Flare, flare

_WHITE, _BLACK, _WALL = 1.0, 0.06, 0.25
_MARGIN_SQUARES = 1.0
_DRAWS_PER_POSE = 40
_EDGE_PX = 8
_PIXEL_VARIANCE_PX2 = 1 / 12


@dataclass(frozen=True, kw_only=True)
class Board:
    """columns x rows inner corners, squares of square_mm, a white margin of one square around."""

    columns: int
    rows: int
    square_mm: float

    @property
    def corners_mm(self) -> np.ndarray:
        """(columns * rows, 3) inner corners, row by row."""
        grid = np.mgrid[: self.rows, : self.columns].reshape(2, -1)[::-1].T
        return np.column_stack([grid * self.square_mm, np.zeros(len(grid))])

    @property
    def outline_mm(self) -> np.ndarray:
        """(4, 3) outer corners of the squares."""
        right, bottom = self.columns * self.square_mm, self.rows * self.square_mm
        left = top = -self.square_mm
        return np.array([[left, top, 0], [right, top, 0], [right, bottom, 0], [left, bottom, 0.0]])


@dataclass(frozen=True, kw_only=True)
class BoardPose:
    """X_cam = R(rotvec_rad) X_board + translation_mm: OpenCV's rvec and tvec."""

    rotvec_rad: tuple[float, float, float]
    translation_mm: tuple[float, float, float]

    def to_camera(self, points_mm: np.ndarray) -> np.ndarray:
        """Board points (N, 3) -> camera axes (N, 3), mm."""
        return points_mm @ matrix_from_rotvec(np.array(self.rotvec_rad)).T + self.translation_mm


def corner_pixels(camera: SimulatedCamera, board: Board, pose: BoardPose) -> np.ndarray:
    """(columns * rows, 2) true pixels of the inner corners, row by row."""
    return project(camera.intrinsics, pose.to_camera(board.corners_mm))


def random_poses(camera: SimulatedCamera, board: Board, count: int, rng: np.random.Generator) -> list[BoardPose]:
    """Poses for a calibration, all squares on the image: pushed in turn to each corner, each edge and the middle, tilted by 20
    to 45 degrees in directions that go round by the golden angle, at distances and rolls drawn at random.

    Raises:
        BadInput: this board cannot be placed so.
    """
    size_px = np.array(camera.image_size_px)
    middle_px = (size_px - 1) / 2
    poses: list[BoardPose] = []
    for _ in range(_DRAWS_PER_POSE * count):
        if len(poses) == count:
            break
        tilt, direction = np.radians(rng.uniform(20, 45)), len(poses) * np.pi * (3 - np.sqrt(5))
        roll = np.radians(rng.uniform(-25, 25))
        rotation = (matrix_from_rotvec(tilt * np.array([np.cos(direction), np.sin(direction), 0.0]))
                    @ matrix_from_rotvec(np.array([0.0, 0.0, roll])))
        # Face on, the squares would take this share of the image's width.
        share = rng.uniform(0.5, 0.85)
        distance_mm = (board.columns + 1) * board.square_mm * camera.intrinsics.fx_px / (share * size_px[0])
        side = np.array([len(poses) % 3 - 1, len(poses) // 3 % 3 - 1])
        outline_px = _outline_px(camera, board, _pose_aimed_at(camera, board, rotation, distance_mm, middle_px))
        room_px = (size_px - np.ptp(outline_px, axis=0)) / 2 - _EDGE_PX
        if not (room_px >= 0).all():  # too large here, or partly behind the camera (NaN)
            continue
        push_px = side * room_px - (outline_px.max(axis=0) + outline_px.min(axis=0)) / 2 + middle_px
        pose = _pose_aimed_at(camera, board, rotation, distance_mm, middle_px + push_px)
        outline_px = _outline_px(camera, board, pose)
        if ((outline_px > 2) & (outline_px < size_px - 3)).all():
            poses.append(pose)
    if len(poses) < count:
        raise BadInput(f"a board of {board.columns}x{board.rows} corners does not fit the image in {count} tilted poses",
                       mend="choose a board whose sides relate more like the image's")
    return poses


def _pose_aimed_at(camera: SimulatedCamera, board: Board, rotation: np.ndarray, distance_mm: float,
                   xy_px: np.ndarray) -> BoardPose:
    """The pose that puts the board's middle on the ray of a pixel."""
    middle_mm = unproject(camera.intrinsics, xy_px[None])[0] * distance_mm
    translation_mm = middle_mm - rotation @ board.corners_mm.mean(axis=0)
    return BoardPose(rotvec_rad=tuple(rotvec_from_matrix(rotation).tolist()), translation_mm=tuple(translation_mm.tolist()))


def _outline_px(camera: SimulatedCamera, board: Board, pose: BoardPose) -> np.ndarray:
    return project(camera.intrinsics, pose.to_camera(board.outline_mm))


def render_board(camera: SimulatedCamera, board: Board, pose: BoardPose, *, white_e: float,
                 blur_sigma_px: float | None = None) -> np.ndarray:
    """Expected electrons (H, W) of the board evenly lit, white_e on its white where the lens is brightest.

    Each pixel's ray is met with the board's plane, and there the pattern is taken as each Gaussian of the lens's PSF sees it,
    in closed form, the pixel's square as 1/12 px^2 more variance, which is its integral to 3e-4 of the contrast (the square's
    fourth cumulant, 1/120 px^4). Against brute force (31 x 31 rays a pixel) corners move by less than 0.003 px.
    blur_sigma_px: a round Gaussian in place of the lens's PSF.

    Raises:
        BadInput: the camera's PSF is a Pupil, which is no sum of Gaussians.
    """
    rotation = matrix_from_rotvec(np.array(pose.rotvec_rad))
    # Board coordinates of the ray's points s d: R^T (s d - t); s is where the third of them is zero.
    origin = -rotation.T @ np.array(pose.translation_mm)
    ray = camera.rays @ rotation
    scale = np.where(origin[2] * ray[..., 2] < 0, -origin[2] / ray[..., 2], np.nan)  # NaN: the ray never meets the plane
    u_mm, v_mm = (scale * ray[..., i] + origin[i] for i in (0, 1))
    (u_by_y, u_by_x), (v_by_y, v_by_x) = np.gradient(u_mm), np.gradient(v_mm)
    parts = _blur(camera, blur_sigma_px)
    cos, sin = parts.outward.T.reshape(2, *u_mm.shape)
    u_out, u_across, v_out, v_across = (u_by_x * cos + u_by_y * sin, u_by_y * cos - u_by_x * sin,
                                        v_by_x * cos + v_by_y * sin, v_by_y * cos - v_by_x * sin)
    light = np.zeros(u_mm.shape)
    for weight, *figures in zip(parts.weight, parts.offset_px, parts.radial_px2, parts.tangential_px2, strict=True):
        offset, radial, tangential = (a.reshape(u_mm.shape) for a in figures)
        radial, tangential = radial + _PIXEL_VARIANCE_PX2, tangential + _PIXEL_VARIANCE_PX2
        u_blur = np.sqrt(radial * u_out**2 + tangential * u_across**2)
        v_blur = np.sqrt(radial * v_out**2 + tangential * v_across**2)
        skew = (radial * u_out * v_out + tangential * u_across * v_across) / (u_blur * v_blur)
        light += weight * _reflectance(board, u_mm - offset * u_out, v_mm - offset * v_out, u_blur, v_blur, skew)
    return white_e * camera.transmission * np.where(np.isfinite(light), light, _WALL)


def _blur(camera: SimulatedCamera, blur_sigma_px: float | None) -> Flare:
    """The PSF about every pixel."""
    aberrations, (width, height) = camera.aberrations, camera.image_size_px
    if blur_sigma_px is not None:
        aberrations = Aberrations(core_sigma_px=blur_sigma_px, radial_blur_px=0.0, tangential_blur_px=0.0, coma_px=0.0,
                                  centre_px=(0.0, 0.0), corner_radius_px=1.0)
    if not isinstance(aberrations, Aberrations):
        raise BadInput("a board through a Pupil is not rendered", mend="give the camera Aberrations, or blur_sigma_px")
    rows, columns = np.mgrid[:height, :width]
    return flare(aberrations, np.column_stack([columns.ravel(), rows.ravel()]))


def _reflectance(board: Board, u_mm: np.ndarray, v_mm: np.ndarray, u_blur_mm: np.ndarray, v_blur_mm: np.ndarray,
                 skew: np.ndarray) -> np.ndarray:
    """The blurred pattern at plane points; *_blur_mm: sigma of the round blur along u and v, skew: their correlation."""
    square, margin = board.square_mm, _MARGIN_SQUARES * board.square_mm
    parity = squares = sheet = 1.0
    sigmas = []  # distance from the nearest inner line, in sigmas of the blur
    for x, blur, corners in ((u_mm, u_blur_mm, board.columns), (v_mm, v_blur_mm, board.rows)):
        line = np.rint(x / square).clip(0, corners - 1)  # the outermost squares end at the outline, not at a line
        parity = parity * np.where(line % 2 == 0, 1.0, -1.0)
        sigmas.append((x - line * square) / blur)
        squares = squares * _inside(x, blur, -square, corners * square)
        sheet = sheet * _inside(x, blur, -square - margin, corners * square + margin)
    grey, contrast = (_WHITE + _BLACK) / 2, (_WHITE - _BLACK) / 2
    checks = parity * _mean_sign_product(*sigmas, skew)
    return _WALL + sheet * (_WHITE - _WALL) + squares * (grey - contrast * checks - _WHITE)


def _mean_sign_product(a: np.ndarray, b: np.ndarray, correlation: np.ndarray) -> np.ndarray:
    """E[sign(a + x) sign(b + y)] for standard normal x, y of this correlation: a checkerboard's corner under a Gaussian blur.

    Plackett (1954, Biometrika 41, 351): the derivative by the correlation is 4 times the normal density; integrated
    over its arc sine by 3 Gauss-Legendre nodes from the uncorrelated product of the two edges.
    """
    out = erf(a / np.sqrt(2)) * erf(b / np.sqrt(2))
    end = np.arcsin(correlation)
    nodes, weights = np.polynomial.legendre.leggauss(3)
    for node, weight in zip(nodes, weights, strict=True):
        angle = (1 + node) / 2 * end
        out = out + weight * end / np.pi * np.exp(-(a**2 - 2 * a * b * np.sin(angle) + b**2) / (2 * np.cos(angle) ** 2))
    return out


def _inside(x: np.ndarray, blur: np.ndarray, low: float, high: float) -> np.ndarray:
    """A blurred 1 between low and high, 0 outside."""
    return 0.5 * (1 + erf(((high - low) / 2 - np.abs(x - (low + high) / 2)) / (np.sqrt(2) * blur)))
