"""The errors of a series by their kind, as ECSS-E-ST-60-20C splits a star sensor's: what the residuals of many frames can tell.

    residual of a star = FOV spatial (smooth over the field) + pixel spatial (with the place within the pixel) + temporal noise

All three are fitted together: a polynomial of the third degree over the field, the first two harmonics of the pixel phase; the
rest is noise. From the size of each on one star, the size on an attitude follows by the frame's own geometry: stars' errors of
variance s^2 turn an attitude by s^2 F^-1, F the sum of J'J over its stars, so that cross-boresight and roll are told apart.

Bias needs truth or a second sensor; thermo-elastic error needs a temperature cycle. A residual shows neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import projection, rotation
from ..stars.solve import Solution

DEGREE, HARMONICS = 3, 2
FEWEST_PER_TERM = 5  # stars for each fitted term
OUTLIER = 4.0  # robust sigma
CELLS = (8, 5)  # of the residual map, along x and y


@dataclass(frozen=True, kw_only=True)
class ErrorKind:
    """One kind of error, 1 sigma: of one axis of one star (px), and of an attitude across the boresight and in roll (rad).

    None where it cannot be told; reason says why.
    """

    name: str
    star_px: float | None = None
    cross_rad: float | None = None
    roll_rad: float | None = None
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class SeriesErrors:
    """kinds: bias, thermo-elastic, FOV spatial, pixel spatial, temporal noise. map_xy_px (C, 2): centres of the cells of the
    residual map that hold stars, map_residual_px (C, 2): mean residual there, map_stars (C,): how many. frames, stars: used."""

    kinds: tuple[ErrorKind, ...]
    map_xy_px: np.ndarray
    map_residual_px: np.ndarray
    map_stars: np.ndarray
    frames: int
    stars: int


def split(solutions: Sequence[Solution]) -> SeriesErrors:
    """The split of the solved frames of one camera; frames that were not solved do not count."""
    solved = [s for s in solutions if s.status == "solved" and len(s.attitude.residual_px)]
    bias = ErrorKind(name="bias", reason="needs truth or a second sensor: a rotation common to all frames leaves no residual")
    thermal = ErrorKind(name="thermo-elastic", reason="needs a temperature cycle against a reference")
    if not solved:
        nothing, why = np.zeros((0, 2)), "no frame was solved"
        rest = tuple(ErrorKind(name=name, reason=why) for name in ("FOV spatial", "pixel spatial", "temporal noise"))
        return SeriesErrors(kinds=(bias, thermal, *rest), map_xy_px=nothing, map_residual_px=nothing,
                            map_stars=np.zeros(0, int), frames=0, stars=0)
    lens = solved[0].identification.intrinsics
    xy = np.concatenate([s.identification.xy_px for s in solved])
    residual = np.concatenate([s.attitude.residual_px for s in solved])
    kinds = (bias, thermal, *(_on_an_attitude(kind, solved) for kind in _star_errors(solved, lens.image_size_px)))
    places, means, counts = _residual_map(xy, residual, lens.image_size_px)
    return SeriesErrors(kinds=kinds, map_xy_px=places, map_residual_px=means, map_stars=counts, frames=len(solved),
                        stars=len(xy))


def _star_errors(solved: Sequence[Solution], size_px: tuple[int, int]) -> list[ErrorKind]:
    """FOV spatial, pixel spatial, temporal noise of one star. Each frame's attitude has taken a part of every error with it: it
    is eliminated from the columns as it is from the residuals, so that no spatial error is taken for noise."""
    names = ("FOV spatial", "pixel spatial", "temporal noise")
    xy = np.concatenate([s.identification.xy_px for s in solved])
    residual = np.concatenate([s.attitude.residual_px for s in solved])
    smooth, pixel = _columns(xy - residual, size_px)  # where the star stood, not where its errors put it
    columns = np.concatenate([smooth, pixel], -1)
    terms = columns.shape[-1]
    if len(xy) < FEWEST_PER_TERM * terms // 2:
        why = f"{len(xy)} stars are too few: {FEWEST_PER_TERM * terms // 2} are needed"
        return [ErrorKind(name=name, reason=why) for name in names]
    length = np.hypot(*residual.T)
    kept = length < OUTLIER * np.median(length) / np.sqrt(2 * np.log(2))
    reduced, rest, first, freedom = [], [], 0, -terms
    for solution in solved:
        rows = first + np.flatnonzero(kept[first:first + len(solution.attitude.residual_px)])
        jacobian = _by_turn(solution)[rows - first].reshape(-1, 3)
        first += len(solution.attitude.residual_px)
        both = np.column_stack([columns[rows].reshape(-1, terms), residual[rows].reshape(-1)])
        both -= jacobian @ (np.linalg.pinv(jacobian) @ both)
        reduced.append(both[:, :-1])
        rest.append(both[:, -1])
        freedom += max(len(both) - 3, 0)
    reduced, rest = np.concatenate(reduced), np.concatenate(rest)
    inverse = np.linalg.pinv(reduced.T @ reduced, rcond=1e-9)
    found = inverse @ reduced.T @ rest
    noise = float(((rest - reduced @ found) ** 2).sum() / max(freedom, 1))
    # A shift or turn of the whole field is an attitude, not an error of the field.
    u = 2 * xy / (np.array(size_px) - 1) - 1
    rigid = np.stack([np.broadcast_to([1.0, 0], u.shape), np.broadcast_to([0, 1.0], u.shape),
                      np.stack([-u[:, 1] * size_px[1], u[:, 0] * size_px[0]], -1)], -1).reshape(-1, 3)
    flat = smooth.reshape(-1, smooth.shape[-1])
    flat = flat - rigid @ (np.linalg.pinv(rigid) @ flat)
    variances = []
    for some, part in ((flat, slice(0, flat.shape[1])), (pixel.reshape(-1, pixel.shape[-1]), slice(flat.shape[1], None))):
        chance = noise * np.einsum("ni,ij,nj->n", some, inverse[part, part], some).mean()
        variances.append(max(float(np.mean((some @ found[part]) ** 2)) - chance, 0.0))
    return [ErrorKind(name=name, star_px=float(np.sqrt(variance))) for name, variance in
            zip(names, (*variances, noise), strict=True)]


def _columns(xy: np.ndarray, size_px: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Smooth terms over the field (N, 2, F) and harmonics of the pixel phase (N, 2, P), each axis with its own."""
    u, v = (2 * xy / (np.array(size_px) - 1) - 1).T
    field = np.stack([u**i * v**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], -1)
    out = []
    for of_x, of_y in ((field, field), tuple(np.stack([f((k + 1) * 2 * np.pi * at) for k in range(HARMONICS)
                                                       for f in (np.sin, np.cos)], -1) for at in xy.T)):
        nothing = np.zeros_like(of_x)
        out.append(np.stack([np.concatenate([of_x, nothing], 1), np.concatenate([nothing, of_y], 1)], 1))
    return out[0], out[1]


def _by_turn(solution: Solution) -> np.ndarray:
    """Derivative (M, 2, 3) of the stars' pixels by a small rotation in camera axes."""
    found = solution.identification
    seen = found.direction_icrs @ rotation.matrix_from_quaternion(solution.attitude.q_cam_icrs).T
    _, by_v, _ = projection.project_with_jacobian(found.intrinsics, seen)
    return by_v @ -rotation.skew(seen)


def _on_an_attitude(kind: ErrorKind, solved: Sequence[Solution]) -> ErrorKind:
    if kind.star_px is None:
        return kind
    cross, roll = [], []
    for solution in solved:
        jacobian = _by_turn(solution)
        covariance = np.linalg.inv((np.swapaxes(jacobian, 1, 2) @ jacobian).sum(0)) * kind.star_px**2
        cross.append((covariance[0, 0] + covariance[1, 1]) / 2)
        roll.append(covariance[2, 2])
    return ErrorKind(name=kind.name, star_px=kind.star_px, cross_rad=float(np.sqrt(np.mean(cross))),
                     roll_rad=float(np.sqrt(np.mean(roll))))


def _residual_map(xy: np.ndarray, residual: np.ndarray, size_px: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Median residual by cell: centres (C, 2), residuals (C, 2), stars (C,)."""
    cell = np.clip(((xy + 0.5) / np.array(size_px) * CELLS).astype(int), 0, np.array(CELLS) - 1)
    index = cell[:, 1] * CELLS[0] + cell[:, 0]
    used = np.unique(index)
    centres = (np.stack([used % CELLS[0], used // CELLS[0]], -1) + 0.5) / CELLS * np.array(size_px) - 0.5
    medians = np.array([np.median(residual[index == i], axis=0) for i in used])
    return centres, medians, np.array([(index == i).sum() for i in used])
