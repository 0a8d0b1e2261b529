"""Bundle adjustment of one camera and many views of one board: Levenberg-Marquardt on the block-arrow normal equations.

Shared parameters (lens, board bow) stand first, then six pose parameters a view. Views touch each other only through the
shared ones, so the 6 x 6 pose blocks are eliminated view by view (Schur complement) and one small dense system
remains. Bow: the board is a shallow dish, z = bow_x (1 - a^2) + bow_y (1 - b^2) with a, b from -1 to 1 across the corners;
z points away from the camera.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import cv2
import numpy as np

from ..errors import BadInput
from ..geometry.projection import project_with_jacobian
from ..geometry.rotation import matrix_from_rotvec, rotvec_from_matrix
from ..records import DISTORTION_NAMES, Intrinsics

MAX_STEPS = 60


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Lens, poses and bow at the optimum.

    rotation (V, 3, 3), translation_mm (V, 3): v_cam = rotation @ board + translation. bow_mm (2,).
    residual_px (V, P, 2): measured minus projected. information (V, S, S) and score (V, S): each view's share of the
    shared parameters' normal equations with its pose eliminated, in px^-2 units; bow included if `with_bow`.
    """

    intrinsics: Intrinsics
    rotation: np.ndarray
    translation_mm: np.ndarray
    bow_mm: np.ndarray
    with_bow: bool
    residual_px: np.ndarray
    information: np.ndarray
    score: np.ndarray


def board_points_mm(board: tuple[int, int], square_mm: float) -> np.ndarray:
    """Corners (P, 3) of a flat board, row by row, mm."""
    columns, rows = np.meshgrid(np.arange(board[0]), np.arange(board[1]))
    return np.stack([columns.ravel(), rows.ravel(), np.zeros(columns.size)], -1) * float(square_mm)


def bow_shape(points_mm: np.ndarray) -> np.ndarray:
    """(P, 2): height of each corner for 1 mm of bow in x and in y; 1 at the centre, 0 at the edges."""
    low, high = points_mm[:, :2].min(axis=0), points_mm[:, :2].max(axis=0)
    return 1 - (2 * (points_mm[:, :2] - low) / (high - low) - 1) ** 2


def start(corners_px: np.ndarray, points_mm: np.ndarray, image_size_px: tuple[int, int], model: str) -> Solution:
    """First guess from the plane homographies (no distortion).

    Raises:
        BadInput: the homographies allow no focal length.
    """
    objects = [points_mm.astype(np.float32)] * len(corners_px)
    images = [c.astype(np.float32) for c in corners_px]
    camera = cv2.initCameraMatrix2D(objects, images, image_size_px, 0)
    if not (np.isfinite(camera).all() and camera[0, 0] > 0 and camera[1, 1] > 0):
        raise BadInput("the views allow no focal length: all show the board at the same tilt",
                       mend="tilt the board by 20 to 45 degrees about both axes, differently in each view")
    terms = len(DISTORTION_NAMES[model])
    intrinsics = Intrinsics(model=model, fx_px=camera[0, 0], fy_px=camera[1, 1], cx_px=camera[0, 2], cy_px=camera[1, 2],
                            distortion=np.zeros(terms), image_size_px=image_size_px,
                            covariance=np.full((4 + terms, 4 + terms), np.inf))
    return with_poses(intrinsics, corners_px, points_mm, bow_mm=np.zeros(2))


def with_poses(intrinsics: Intrinsics, corners_px: np.ndarray, points_mm: np.ndarray, *, bow_mm: np.ndarray) -> Solution:
    """Start values with the poses under a given lens."""
    terms = np.zeros(8)
    terms[: len(intrinsics.distortion)] = intrinsics.distortion
    poses = [cv2.solvePnP(points_mm, c, intrinsics.camera_matrix, terms)[1:] for c in corners_px]
    rotvec, translation = (np.array([p[i].ravel() for p in poses]) for i in (0, 1))
    empty = np.zeros((len(poses), 0))
    return Solution(intrinsics=intrinsics, rotation=matrix_from_rotvec(rotvec), translation_mm=translation, bow_mm=bow_mm,
                    with_bow=False, residual_px=np.zeros((*corners_px.shape,)), information=empty, score=empty)


def adjust(guess: Solution, corners_px: np.ndarray, points_mm: np.ndarray, inlier: np.ndarray, *,
           with_bow: bool, lens_fixed: bool = False) -> Solution:
    """Least squares over lens, bow and poses.

    Args:
        corners_px: (V, P, 2). points_mm: (P, 3) flat board. inlier: (V, P) bool, corners that count.
        lens_fixed: poses only (for held-out views); lens and bow stay as guessed.

    Raises:
        BadInput: the normal equations are singular or the projection leaves the image model.
    """
    shared = 0 if lens_fixed else 4 + len(guess.intrinsics.distortion) + 2 * with_bow
    state = guess
    residual, by_shared, by_pose = _linearise(state, corners_px, points_mm, inlier, shared)
    if not np.isfinite(residual).all():
        raise BadInput("a first guess of the board's place could not be made", mend="leave out blurred or partly hidden views")
    cost, damping = np.sum(residual**2), 1e-3
    for _ in range(MAX_STEPS):
        step_shared, step_pose = _step(residual, by_shared, by_pose, damping)
        trial = _moved(state, step_shared, step_pose)
        moved = trial and _linearise(trial, corners_px, points_mm, inlier, shared)
        trial_cost = np.sum(moved[0] ** 2) if moved else np.inf
        if not trial_cost <= cost:
            damping *= 10
            if damping > 1e8:
                break
            continue
        gain = cost - trial_cost
        state, cost, (residual, by_shared, by_pose) = trial, trial_cost, moved
        damping = max(damping / 10, 1e-12)
        if gain <= 1e-10 * cost:
            break
    information, score = _reduced(residual, by_shared, by_pose)
    everywhere = _linearise(state, corners_px, points_mm, np.ones_like(inlier), 0)[0].reshape(corners_px.shape)
    return dataclasses.replace(state, residual_px=everywhere, information=information, score=score, with_bow=with_bow)


def _linearise(state: Solution, corners_px: np.ndarray, points_mm: np.ndarray, inlier: np.ndarray, shared: int) -> tuple:
    """Residual (V, 2P) and derivatives of the projection by shared (V, 2P, S) and pose (V, 2P, 6); outliers are zero rows."""
    views, points = inlier.shape
    shape = bow_shape(points_mm)
    board = points_mm + np.outer(shape @ state.bow_mm, (0, 0, 1))
    turned = np.einsum("vij,pj->vpi", state.rotation, board)
    v_cam = (turned + state.translation_mm[:, None]).reshape(-1, 3)
    xy, by_v, by_lens = project_with_jacobian(state.intrinsics, v_cam)
    by_v = by_v.reshape(views, points, 2, 3)
    keep = inlier[..., None]
    residual = np.where(keep, corners_px - xy.reshape(corners_px.shape), 0)
    x, y, z = np.moveaxis(turned, -1, 0)
    o = np.zeros_like(x)
    minus_cross = np.stack([np.stack([o, z, -y], -1), np.stack([-z, o, x], -1), np.stack([y, -x, o], -1)], -2)
    by_pose = np.concatenate([by_v @ minus_cross, by_v], -1)
    lens = by_lens.reshape(views, points, 2, -1)
    by_bow = np.einsum("vpij,vj,pb->vpib", by_v, state.rotation[:, :, 2], shape)
    by_shared = np.concatenate([lens, by_bow], -1)[..., :shared]
    flat = (views, 2 * points, -1)
    return (residual.reshape(views, -1), np.where(keep[..., None], by_shared, 0).reshape(views, 2 * points, shared),
            np.where(keep[..., None], by_pose, 0).reshape(flat))


def _normal(residual: np.ndarray, by_shared: np.ndarray, by_pose: np.ndarray) -> tuple[np.ndarray, ...]:
    to_pose = by_pose.swapaxes(1, 2)
    to_shared = by_shared.swapaxes(1, 2)
    return (to_shared @ by_shared, to_shared @ by_pose, to_pose @ by_pose,
            (to_shared @ residual[..., None])[..., 0], (to_pose @ residual[..., None])[..., 0])


def _step(residual: np.ndarray, by_shared: np.ndarray, by_pose: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Damped step: shared (S,), poses (V, 6). Damping scales with each diagonal (Marquardt)."""
    a, b, c, g, h = _normal(residual, by_shared, by_pose)
    a = a.sum(axis=0)
    a[np.diag_indices_from(a)] *= 1 + damping
    c[:, range(6), range(6)] *= 1 + damping
    try:
        solved = np.linalg.solve(c, np.concatenate([b.swapaxes(1, 2), h[..., None]], -1))
        into, at = solved[..., :-1], solved[..., -1]
        reduced = a - np.einsum("vsp,vpt->st", b, into)
        scale = 1 / np.sqrt(np.diag(reduced).clip(1e-300))
        right = g.sum(axis=0) - np.einsum("vsp,vp->s", b, at)
        shared = scale * np.linalg.solve(reduced * np.outer(scale, scale), scale * right)
    except np.linalg.LinAlgError as error:
        raise BadInput("the views do not determine the lens: the normal equations are singular",
                       mend="take more views, tilted 20 to 45 degrees about both axes, that fill the image") from error
    return shared, at - into @ shared


def _moved(state: Solution, shared: np.ndarray, poses: np.ndarray) -> Solution | None:
    """State after a step; None where the step leaves the possible (a negative focal length)."""
    lens = state.intrinsics
    terms = len(lens.parameter_names)
    bow = state.bow_mm + (shared[terms:] if len(shared) > terms else 0)
    if len(shared):
        p = lens.parameters + shared[:terms]
        if not (p[0] > 0 and p[1] > 0):
            return None
        lens = dataclasses.replace(lens, fx_px=p[0], fy_px=p[1], cx_px=p[2], cy_px=p[3], distortion=p[4:])
    return dataclasses.replace(state, intrinsics=lens, bow_mm=bow, rotation=matrix_from_rotvec(poses[:, :3]) @ state.rotation,
                               translation_mm=state.translation_mm + poses[:, 3:])


def _reduced(residual: np.ndarray, by_shared: np.ndarray, by_pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each view's information (V, S, S) and score (V, S) about the shared parameters, its pose eliminated."""
    a, b, c, g, h = _normal(residual, by_shared, by_pose)
    into = np.linalg.solve(c, np.concatenate([b.swapaxes(1, 2), h[..., None]], -1))
    return a - b @ into[..., :-1], g - (b @ into[..., -1:])[..., 0]


def covariances(solution: Solution, inlier: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Classical and view-clustered covariance (S, S) of the shared parameters.

    Classical: sigma^2 (J'J)^-1 with sigma^2 from the residuals. Clustered: the sandwich over views with the
    small-sample correction CR2 (Bell and McCaffrey 2002, Survey Methodology 28), which is unbiased when errors are
    independent and stays true when all corners of a view err together.
    """
    shared = solution.score.shape[1]
    counted = 2 * int(inlier.sum())
    variance = np.sum(solution.residual_px[inlier] ** 2) / (counted - shared - 6 * len(inlier))
    total = solution.information.sum(axis=0)
    scale = 1 / np.sqrt(np.diag(total))
    root = scale[:, None] * np.linalg.cholesky(np.linalg.inv(total * np.outer(scale, scale)))  # root @ root.T = total^-1
    weight, axes = np.linalg.eigh(root.T @ solution.information @ root)  # leverage of each view
    white = np.einsum("vij,vi->vj", axes, solution.score @ root) / np.sqrt(np.maximum(1 - weight, 1e-6))
    white = np.einsum("vij,vj->vi", axes, white) @ root.T
    return variance * root @ root.T, white.T @ white


def poses_of(solution: Solution) -> np.ndarray:
    """(V, 6): rotation vector in rad, translation in mm."""
    return np.concatenate([[rotvec_from_matrix(r) for r in solution.rotation], solution.translation_mm], axis=1)
