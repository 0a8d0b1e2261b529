"""Sub-pixel centre of symmetry: a corner of a checkerboard, or the middle of a dot, looks the same after half a turn.

Half a turn on the board takes a pattern into itself about such a point, whatever the blur, the angle of the edges and the
camera's response curve. So the point c is sought at which the light at c + d equals that at c - d:

1. Fit a smooth map from board to image through all points of the view: local axes, and their bend (perspective, lens).
2. Sample the image under a small Gaussian on a lattice centred at c, exactly at sub-pixel places.
3. Gauss-Newton: odd part of the samples = - gradient . step, minus what the bend alone makes odd; windowed on the board.
The weights fall to zero at the window's border, which is the same piece of the board in every view. As an estimator of
location with an unknown even shape it loses no information to the unknown shape (Stein 1956; van Eeden 1970).
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from .kernels import odd_parts

SIGMA_PX = 0.8  # below this a Gaussian sum over pixels depends on where the pixels lie (2 exp(-2 pi^2 sigma^2))
MARGIN_PX = 4  # of the Gaussian around the lattice
MOST_ROUNDS = 8
NEAR_PX = 0.1  # Newton: after a step of this length the next one is 0.001 px
LEAST_HALF_PX = 3.0
MOST_HALF_PX = 32  # a larger window is seen in larger pixels
MOST_HALF = 0.5  # of the spacing: beyond stands what belongs to the neighbour
FARTHEST = 0.25  # of the spacing: a refinement that leaves farther than this has lost its point
STEP_PX = 1.5
QUANTISATION_VARIANCE = 1 / 12


def refine(grey: np.ndarray, xy_px: np.ndarray, places: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Refined points and the covariance that the noise around each of them gives.

    Args:
        grey: (H, W) float image. xy_px: (P, 2) to about a pixel, NaN: not seen. places: (P, 2) on the board in spacings
            of the nearest neighbour. window: half width of the window in the same unit.

    Returns:
        xy_px (P, 2), covariance_px2 (P, 2, 2); NaN where not seen or lost. The covariance holds noise of the image; errors of
        the print come on top.
    """
    out, covariance = np.full(xy_px.shape, np.nan), np.full((len(xy_px), 2, 2), np.nan)
    seen = np.flatnonzero(np.isfinite(xy_px).all(axis=-1))
    start, uv = xy_px[seen].astype(float), places[seen]
    centre = start
    axes, bend, _ = local_map(start, uv)
    spacing = np.linalg.norm(axes, axis=1).min(axis=-1)
    if not (np.abs(np.linalg.det(axes)) > spacing).all():  # the points lie on a line, or their order is confused
        return out, covariance
    half = np.minimum(np.maximum(window, LEAST_HALF_PX / spacing), MOST_HALF)
    reach = float((half[:, None] * np.abs(axes).sum(axis=-1)).max())
    if reach > MOST_HALF_PX:
        by = int(np.ceil(reach / MOST_HALF_PX))
        xy, covariance = refine(_binned(grey, by), (xy_px - (by - 1) / 2) / by, places, window)
        return xy * by + (by - 1) / 2, covariance * by**2
    padded = np.pad(grey, MOST_HALF_PX + MARGIN_PX, mode="edge")
    for _ in range(MOST_ROUNDS):
        step, *fit = _step(padded, centre, axes, bend, half)
        centre = centre + np.clip(step, -STEP_PX, STEP_PX)
        if not (np.abs(step) > NEAR_PX).any():
            break
        if np.isfinite(step).all():  # a better map of the bend
            axes, bend, _ = local_map(centre, uv)
    kept = np.linalg.norm(centre - start, axis=1) < FARTHEST * spacing  # not where the step is NaN: nothing to see there
    if kept.any():
        out[seen[kept]] = centre[kept]
        covariance[seen[kept]] = _covariance(step, *fit)[kept]
    return out, covariance


def _binned(grey: np.ndarray, by: int) -> np.ndarray:
    """(H // by, W // by) means: in large images the edges are longer, and a pixel of the window may be larger."""
    height, width = (n // by for n in grey.shape)
    return cv2.resize(grey[:height * by, :width * by].astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)


def roughness_px(xy_px: np.ndarray, uv: np.ndarray) -> float:
    """Median distance of the seen points from a smooth map of the board, px: what no lens can do."""
    seen = np.isfinite(xy_px).all(axis=-1)
    return float(np.median(np.linalg.norm(local_map(xy_px[seen], uv[seen])[2], axis=1)))


def local_map(xy_px: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Axes (P, 2, 2) px a spacing, columns by u and v; bend (P, 2, 3), terms of uu, uv, vv; residual (P, 2) of the points."""
    smooth, by_u, by_v, *second = _smoothing(uv.tobytes()) @ xy_px
    return np.stack([by_u, by_v], axis=-1), np.stack(second, axis=-1), xy_px - smooth


@lru_cache(maxsize=16)  # most views show the same points
def _smoothing(places: bytes) -> np.ndarray:
    """(6, P, P): values and derivatives (u, v, uu / 2, uv, vv / 2) of a polynomial through values at P places, at these places.

    A polynomial through the whole view, of as high a degree as the points bear, averages the error of each point.
    """
    uv = np.frombuffer(places).reshape(-1, 2)
    degree = next(d for d, points in ((4, 25), (3, 16), (2, 9), (1, 0)) if len(uv) >= points)
    middle = uv.mean(axis=0)
    scale = np.abs(uv - middle).max()
    i, j = np.array([(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]).T
    order = np.arange(1, degree + 1)
    u, v = (((uv - middle) / scale)[:, axis, None] ** np.arange(degree + 1) for axis in (0, 1))
    u1, v1 = (np.pad(x[:, :-1] * order, ((0, 0), (1, 0))) / scale for x in (u, v))
    u2, v2 = (np.pad(x[:, :-1] * order, ((0, 0), (1, 0))) / scale for x in (u1, v1))
    terms = np.array([a[:, i] * b[:, j] for a, b in ((u, v), (u1, v), (u, v1), (u2 / 2, v), (u1, v1), (u, v2 / 2))])
    return terms @ np.linalg.pinv(terms[0])


def _step(padded: np.ndarray, centre: np.ndarray, axes: np.ndarray, bend: np.ndarray,
          half: np.ndarray) -> tuple[np.ndarray, ...]:
    """Gauss-Newton step (P, 2) px, inverse normal matrix (P, 2, 2), weight (P, n, n), gradient (P, 2, n, n), odd part."""
    reach = int(min(np.ceil((half[:, None] * np.abs(axes).sum(axis=-1)).max()), MOST_HALF_PX))  # axes change a little
    border = MOST_HALF_PX + MARGIN_PX
    side = 2 * (reach + MARGIN_PX) + 1
    size = np.array(padded.shape[::-1]) - 2 * border
    whole = np.rint(np.clip(np.nan_to_num(centre), 0, size - 1)).astype(int)
    column, row = (whole + border - reach - MARGIN_PX).T
    patch = np.lib.stride_tricks.sliding_window_view(padded, (side, side))[row, column].astype(np.float32)
    points, n = len(centre), 2 * reach + 1
    weight, odd = np.empty((2, points, n, n), np.float32)
    gradient, sums = np.empty((points, 2, n, n), np.float32), np.empty((points, 5))
    odd_parts(patch, centre - whole, SIGMA_PX, np.minimum(whole, size - 1 - whole), np.linalg.inv(axes),
              np.ascontiguousarray(bend), half, weight, gradient, odd, sums)
    xx, xy, yy, *right = sums.T
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = (np.array([[yy, -xy], [-xy, xx]]) / (xx * yy - xy * xy)).transpose(2, 0, 1)
        return -(inverse @ np.stack(right, -1)[..., None])[..., 0], inverse, weight, gradient, odd


def _products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sums over the lattice of a (P, i, n, n) times b (P, j, n, n): (P, i, j)."""
    a, b = (x.reshape(*x.shape[:2], -1) for x in (a, b))
    return (a @ b.swapaxes(1, 2)).astype(float)


def _covariance(step: np.ndarray, inverse: np.ndarray, weight: np.ndarray, gradient: np.ndarray,
                odd: np.ndarray) -> np.ndarray:
    """(P, 2, 2) px^2: pixel noise through the estimator; the noise is what stays odd where the edges are.

    Half of it is the point's own estimate and half the view's median, because a small window alone knows its noise badly.
    """
    weighted = gradient * weight[:, None]
    d = np.arange(odd.shape[1])
    spread = 2 * SIGMA_PX**2  # samples share pixels: their correlation is the Gaussian folded with itself
    shared = np.exp(-0.5 * (d[:, None] - d) ** 2 / spread) / np.sqrt(2 * np.pi * spread)
    shared = np.where(shared > 1e-9, shared, 0).astype(np.float32)  # no denormal numbers: they are slow
    unit = inverse @ _products(shared @ weighted @ shared, weighted) @ inverse  # for pixel noise of 1
    left = odd + gradient[:, 0] * step[:, 0, None, None] + gradient[:, 1] * step[:, 1, None, None]
    edges = (weighted * gradient).sum(axis=1, keepdims=True)
    freedom = edges.sum(axis=(1, 2, 3)) / (4 * np.pi * spread)  # variance of the odd part of smoothed noise of 1
    fitted = (_products(edges * gradient, gradient) * unit).sum(axis=(1, 2))
    own = _products(edges, left[:, None] ** 2)[:, 0, 0] / np.maximum(freedom - fitted, 0.3 * freedom)
    noise = np.maximum((own + np.nanmedian(own)) / 2, QUANTISATION_VARIANCE)
    return noise[:, None, None] * unit
