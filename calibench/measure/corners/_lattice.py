"""Saddle points grown into a lattice: which of them are neighbours on a board, and at which columns and rows they stand.

From a corner along an edge the next corner is the nearest saddle there whose dark and bright quarters are exchanged, and the
way back must be the same. Numbers go from corner to corner along such steps; a corner that would get two is none.
"""

from __future__ import annotations

import cv2
import numpy as np

from ._saddles import Saddles, circle, likeness, saddles, sampled
from ._symmetry import local_map

NEAREST = 12  # saddles around each that may be its neighbours
STRAIGHT = np.cos(np.radians(18))
LEAST_CORNERS = 9
LEAST_LINES = 3
LEAST_OF_A_LINE = 2  # of an outermost line: one alone may be chance
ROUGHEST = 0.15  # of the spacing: farther from the board's smooth map no corner lies
CLEAR = 0.3  # of the spacing: within that a corner looks the same after half a turn, or something covers it
LEAST_LIKENESS = 0.85
LARGEST_PX = 1600  # of the image's longer side: in larger ones corners are sought in larger pixels


def seen_lattice(grey: np.ndarray) -> tuple[np.ndarray, int, tuple[np.ndarray, np.ndarray] | None]:
    """The view (h, w) float32, slightly blurred, in pixels larger by a whole number; that number; its `lattice` in them."""
    by = -(-max(grey.shape) // LARGEST_PX)
    small = cv2.resize(grey, None, fx=1 / by, fy=1 / by, interpolation=cv2.INTER_AREA) if by > 1 else grey
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), 1.0)
    return smooth, by, lattice(smooth, saddles(small))


def lattice(smooth: np.ndarray, found: Saddles) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners (N, 2) px and their columns and rows (N, 2), int, from 0, right-handed; None where no board is seen.

    smooth: (H, W) float32, the view slightly blurred.
    The lattice says nothing of what lies beyond it: the first column seen may be any of the board's.
    """
    steps = _steps(found)
    best = np.zeros((0, 3), int)
    left = np.ones(len(found.xy_px), bool)
    while left.sum() > len(best):
        seed = int(left.argmax())
        grown = _grown(seed, found, steps)
        left[[seed, *grown[:, 0]]] = False
        best = grown if len(grown) > len(best) else best
    if len(best) < LEAST_CORNERS:
        return None
    xy, uv = found.xy_px[best[:, 0]], best[:, 1:]
    for _ in range(3):
        good = _whole_lines(uv)
        xy, uv = xy[good], uv[good]
        if len(uv) < LEAST_CORNERS or (np.ptp(uv, axis=0) + 1 < LEAST_LINES).any():
            return None
        clear = _clear(smooth, xy, uv)
        if clear.all():
            return xy, uv - uv.min(axis=0)
        xy, uv = xy[clear], uv[clear]
    return None


def _steps(found: Saddles) -> np.ndarray:
    """(N, 4) the neighbour of each saddle along its first edge, its second, and backwards along both; -1: none."""
    count = len(found.xy_px)
    out = np.full((count, 4), -1)
    if count < 2:
        return out
    apart = found.xy_px[None] - found.xy_px[:, None]
    distance = np.linalg.norm(apart, axis=-1)
    distance[np.diag_indices(count)] = np.inf
    near = np.argsort(distance, axis=1)[:, :NEAREST]
    rows = np.arange(count)[:, None]
    way = apart[rows, near] / distance[rows, near][..., None]
    for k in range(4):
        edge = found.edges[:, k % 2] * (1 - 2 * (k // 2))
        # the neighbour's edge along this step is its other one: there dark and bright are exchanged
        other = np.abs((found.edges[near, 1 - k % 2] * way).sum(axis=-1))
        fits = ((way * edge[:, None]).sum(axis=-1) > STRAIGHT) & (other > STRAIGHT)
        first = fits.argmax(axis=1)
        out[:, k] = np.where(fits.any(axis=1), near[np.arange(count), first], -1)
    back = (out[out] == np.arange(count)[:, None, None]).any(axis=2)
    return np.where((out >= 0) & back, out, -1)


def _grown(seed: int, found: Saddles, steps: np.ndarray) -> np.ndarray:
    """(M, 3): saddle, column, row of all that can be reached from one saddle without contradiction."""
    first, second = found.edges[seed]
    second = second if first[0] * second[1] > first[1] * second[0] else -second
    place, axes, taken, wrong = {seed: (0, 0)}, {seed: (first, second)}, {(0, 0): seed}, set()
    queue = [seed]
    for i in queue:
        for j in {int(j) for j in steps[i] if j >= 0}:
            way = found.xy_px[j] - found.xy_px[i]
            along = [float(way @ axis) for axis in axes[i]]
            k = int(abs(along[1]) > abs(along[0]))
            at = list(place[i])
            at[k] += 1 if along[k] > 0 else -1
            if j in place:
                wrong |= {i, j} if place[j] != tuple(at) else set()
            elif tuple(at) in taken:
                wrong |= {j, taken[tuple(at)]}
            else:
                place[j], taken[tuple(at)] = tuple(at), j
                axes[j] = tuple(_nearest(found.edges[j], axis) for axis in axes[i])
                queue.append(j)
    return np.array([(i, *place[i]) for i in place if i not in wrong], int).reshape(-1, 3)


def _nearest(edges: np.ndarray, axis: np.ndarray) -> np.ndarray:
    along = edges @ axis
    k = int(np.abs(along).argmax())
    return edges[k] * np.sign(along[k])


def _whole_lines(uv: np.ndarray) -> np.ndarray:
    """(N,) without outermost columns and rows of fewer than LEAST_OF_A_LINE corners."""
    good = np.ones(len(uv), bool)
    while good.any():
        bad = np.zeros(len(uv), bool)
        for axis in (0, 1):
            for end in (uv[good, axis].min(), uv[good, axis].max()):
                line = good & (uv[:, axis] == end)
                bad |= line & (line.sum() < LEAST_OF_A_LINE)
        if not bad.any():
            break
        good &= ~bad
    return good


def _clear(smooth: np.ndarray, xy: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(N,) corners on the smooth map of the board that nothing covers as far as a refinement may look."""
    axes, _, residual = local_map(xy, uv.astype(float))
    spacing = np.sqrt(np.abs(np.linalg.det(axes)))
    ring = sampled(smooth, xy[:, None] + CLEAR * circle() @ axes.swapaxes(1, 2))
    return (np.linalg.norm(residual, axis=1) < np.maximum(ROUGHEST * spacing, 1.0)) & (likeness(ring) > LEAST_LIKENESS)
