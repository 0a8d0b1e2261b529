"""Through focus: where over the field the spots are smallest, and where a star's place is known best.

The mean second moment of a spot is even in defocus, and near the focus a parabola. Over positions z and field

    s = B d^2 + C d^4 + P(x, y),    d = z - z0(x, y),    z0 = 1, x, y, r^2;  P of degree 4

where z0 is the focal surface with its tilt and its curvature; C (where there are more positions than FEWEST_POSITIONS) stands
for diffraction and for what a Gaussian does not see of a wide spot. With astigmatism z0 is the medial focus. Two errors add
up: that by leaving out parts of the field in turn, because a pinhole's misfit is the same at all positions, and that by
leaving out positions, because what the formula does not hold is the same at all pinholes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...records import PsfMap, Quantity
from ...spots.psf import light
from .field import gaussian_member
from .figures import BRIGHT_E, DARK_NOISE_E2, FAINT_E, places
from .quantities import jackknife
from .spot_shapes import SpotShapes

FEWEST_POSITIONS = 3
WIDEST = 4.0  # times the least moment: beyond, the image of the pupil shows and the parabola ends
CELLS, PARTS = 6, 6
CLIP_SIGMA, STEPS = 4.0, 8
POWERS = np.array([2, 4])
PHASES = 4
STAR_E = float(np.sqrt(BRIGHT_E * FAINT_E))  # of the star whose place is to be known best


@dataclass(frozen=True, kw_only=True)
class Series:
    """Spots of all positions: focus_um (P,) positions ascending; spot_focus_um (N,), xy_px (N, 2), moments_px2 (N, 3)."""

    focus_um: np.ndarray
    spot_focus_um: np.ndarray
    xy_px: np.ndarray
    moments_px2: np.ndarray
    image_size_px: tuple[int, int]

    def take(self, rows: np.ndarray) -> Series:
        return Series(focus_um=self.focus_um, spot_focus_um=self.spot_focus_um[rows], xy_px=self.xy_px[rows],
                      moments_px2=self.moments_px2[rows], image_size_px=self.image_size_px)

    @property
    def sizes_px2(self) -> np.ndarray:
        """(P,) median over the spots of a position of the mean second moment."""
        mean = self.moments_px2[:, :2].mean(1)
        return np.array([np.median(mean[self.spot_focus_um == z]) if (self.spot_focus_um == z).any() else np.inf
                         for z in self.focus_um])


def series_of(found: Sequence[SpotShapes], focus_um: Sequence[float], image_size_px: tuple[int, int]) -> Series:
    """The spots of frames with their focus positions."""
    return Series(focus_um=np.unique(focus_um), spot_focus_um=np.repeat(focus_um, [len(s.xy_px) for s in found]),
                  xy_px=np.concatenate([s.xy_px for s in found]), moments_px2=np.concatenate([s.moments_px2 for s in found]),
                  image_size_px=image_size_px)


def focus_quantities(series: Series) -> tuple[list[Quantity], dict[str, np.ndarray]]:
    """Best focus over the field and of the centroid, with errors; and the curves by position as evidence."""
    out, outside, surface = surface_quantities(series)
    bounds = centroid_bounds_px(series)
    out.append(_centroid_focus(series, bounds, outside))
    evidence = {"focus_um": series.focus_um, "focus_moment_px2": series.sizes_px2, "focus_centroid_bound_px": bounds,
                "focus_surface_um": surface}
    return out, evidence


def surface_quantities(series: Series) -> tuple[list[Quantity], str, np.ndarray]:
    """Best focus, tilts and curvature; why there are none (else ""); the best focus, um, at `places`."""
    fewer = _without_positions(series)
    powers = POWERS if fewer else POWERS[:1]
    whole, *others = (_figures(one, powers) for one in (series, *fewer, *_without_cells(series)))
    low, high = series.focus_um[[0, -1]]
    outside = "" if low < whole["focus_best_um"] < high else "the series does not reach both sides of the best focus"
    reason = outside or ("" if fewer else f"no error: {FEWEST_POSITIONS} positions near the focus, none can be left out")
    what = {"focus_best_um": "position of the least mean second moment, mean over the field",
            "focus_tilt_x_um": "best focus at the right edge of the image less that at the left",
            "focus_tilt_y_um": "best focus at the lower edge of the image less that at the upper",
            "focus_curvature_um": "best focus in the corners less that in the centre, tilt apart"}
    out = []
    for name, source in what.items():
        values = [other[name] for other in others]
        error = None if reason else float(np.hypot(jackknife(values[:len(fewer)]), jackknife(values[len(fewer):])))
        out.append(Quantity(name=name, value=None if outside else whole[name], uncertainty=error, unit="um", source=source,
                            reason=reason))
    return out, outside, _surface(series, places(series.image_size_px), powers)[0]


def _centroid_focus(series: Series, bounds: np.ndarray, outside: str) -> Quantity:
    best = _least(series.focus_um, np.log(bounds))
    others = [_least(one.focus_um, np.log(centroid_bounds_px(one))) for one in _without_parts(series)]
    reason = outside or ("" if np.isfinite(best) else "the least bound is at the end of the series")
    known = not reason and np.isfinite(others).all()
    return Quantity(name="focus_centroid_um", value=None if reason else best, unit="um",
                    source=f"position of the least Cramer-Rao bound of a star's place ({STAR_E:g} e-, 10 e- of noise)",
                    reason=reason or ("" if known else "no error: without some of the spots the series ends there"),
                    uncertainty=jackknife(others) if known else None)


def _cells(series: Series) -> np.ndarray:
    """(N, 2) column and row of each spot's cell."""
    return np.clip((series.xy_px + 0.5) / np.array(series.image_size_px) * CELLS, 0, CELLS - 1).astype(int)


def _without_parts(series: Series) -> list[Series]:
    part = _cells(series) @ [1, 2] % PARTS
    return [series.take(part != one) for one in np.unique(part)]


def _without_cells(series: Series) -> list[Series]:
    """Each cell left out by itself: with PARTS parts an error is known to a third only, and is often far too small."""
    cell = _cells(series) @ [1, CELLS]
    return [series.take(cell != one) for one in np.unique(cell)]


def _without_positions(series: Series) -> list[Series]:
    """Each position near the focus left out; none where no more than FEWEST_POSITIONS are near."""
    near = _near(series)
    if len(near) == FEWEST_POSITIONS:
        return []
    return [replace(series.take(series.spot_focus_um != z), focus_um=series.focus_um[series.focus_um != z]) for z in near]


def _near(series: Series) -> np.ndarray:
    """Positions near enough to the focus for `_surface`, ascending."""
    sizes = series.sizes_px2
    return series.focus_um[np.unique(np.r_[sizes.argsort()[:FEWEST_POSITIONS], np.flatnonzero(sizes < WIDEST * sizes.min())])]


def _figures(series: Series, powers: np.ndarray) -> dict[str, float]:
    w, h = series.image_size_px
    half = np.hypot(w - 1, h - 1) / 2
    surface, terms = _surface(series, places(series.image_size_px), powers)
    return {"focus_best_um": float(surface.mean()), "focus_tilt_x_um": float(terms[1] * (w - 1) / half),
            "focus_tilt_y_um": float(terms[2] * (h - 1) / half), "focus_curvature_um": float(terms[3])}


def _surface(series: Series, at_px: np.ndarray, powers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Best focus (M,) um at (M, 2) places, and its terms 1, x, y, r^2 (half diagonals from the centre).

    powers: of the defocus, some of POWERS.
    """
    near = _near(series)
    rows = np.isin(series.spot_focus_um, near)
    middle, reach = series.focus_um[series.sizes_px2.argmin()], np.ptp(near)
    z, s = (series.spot_focus_um[rows] - middle) / reach, series.moments_px2[rows, :2].mean(1)
    x, y, r2 = _coordinates(series.xy_px[rows], series.image_size_px)
    tilted = np.column_stack([np.ones_like(x), x, y, r2])
    spread = np.column_stack([tilted, x * y, x**2 - y**2, r2**2, r2 * x, r2 * y])
    start = np.linalg.lstsq(np.column_stack([z**2, tilted * z[:, None], spread]), s, rcond=None)[0]  # C = 0 is linear
    growth, terms, used = start[0] * (powers == 2), -start[1:5] / (2 * start[0]), np.ones(len(s), bool)
    for _ in range(STEPS):
        away = (z - tilted @ terms)[:, None]
        slope = (growth * powers * away ** (powers - 1)).sum(1, keepdims=True)
        design = np.column_stack([away**powers, -slope * tilted, spread])
        found = np.linalg.lstsq(design[used], s[used], rcond=None)[0]
        growth, terms = found[:len(powers)], terms + found[len(powers):len(powers) + 4]
        residual = s - design @ found
        used = np.abs(residual) <= CLIP_SIGMA * 1.4826 * np.median(np.abs(residual[used])) + 1e-12
    terms = terms * reach
    terms[0] += middle
    x, y, r2 = _coordinates(at_px, series.image_size_px)
    return np.column_stack([np.ones_like(x), x, y, r2]) @ terms, terms


def _coordinates(xy_px: np.ndarray, image_size_px: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y, r^2 (N,) each, from the image's centre in half diagonals."""
    size = np.array(image_size_px) - 1
    x, y = ((xy_px - size / 2) / (np.hypot(*size) / 2)).T
    return x, y, x**2 + y**2


def _least(at: np.ndarray, values: np.ndarray) -> float:
    """Where the parabola through the least value and its two neighbours is least; NaN at the end of the series."""
    i = int(np.argmin(values))
    if i in (0, len(at) - 1):
        return float("nan")
    a, b, _ = np.polyfit(at[i - 1:i + 2] - at[i], values[i - 1:i + 2], 2)
    return float(at[i] - b / (2 * a))


def centroid_bounds_px(series: Series) -> np.ndarray:
    """(P,) bound of a star's place a axis at each position, rms over field and phases, by the Gaussian member there."""
    out = []
    for z in series.focus_um:
        rows = series.spot_focus_um == z
        psf, _, _ = gaussian_member(series.xy_px[rows], series.moments_px2[rows], series.image_size_px)
        out.append(np.sqrt(np.mean([_variance_px2(psf, at) for at in places(series.image_size_px)])))
    return np.array(out)


def _variance_px2(psf: PsfMap, xy_px: np.ndarray) -> float:
    """Cramer-Rao variance a axis of a star's place with flux and background free, mean over phases."""
    sigma = np.sqrt(max(psf.coefficients[:2, 0].max(), 0.1))
    radius = int(np.clip(np.ceil(4 * sigma), 4, 12))
    side = 2 * radius + 1
    offsets = (np.arange(side * PHASES) + 0.5) / PHASES - radius - 0.5
    image = light(psf, xy_px, offsets, offsets)
    slopes = np.gradient(image, 1 / PHASES)
    unit, down, across = (a.reshape(side, PHASES, side, PHASES).transpose(1, 3, 0, 2).reshape(PHASES**2, -1)
                          for a in (image, *slopes))
    jacobian = np.stack([STAR_E * across, STAR_E * down, unit, np.ones_like(unit)], -1)
    weight = 1 / (DARK_NOISE_E2 + STAR_E * unit)
    covariance = np.linalg.inv(np.swapaxes(jacobian * weight[..., None], 1, 2) @ jacobian)
    return float(np.mean(covariance[:, 0, 0] + covariance[:, 1, 1]) / 2)
