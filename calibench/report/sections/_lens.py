"""Figures of a lens: its distortion over the field and along a radius, and how uncertain its projection is at infinity."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...geometry import projection, rotation
from ...records import DISTORTION_NAMES, Intrinsics
from ..draw import BLUE, FAINT, GREY, HALF, grid_px, png, sensor_field, sensor_sheet, sheet
from ..numbers import number, percent, sentence, with_uncertainty
from ..section import Figure

FIELD = (48, 32)  # samples over the image, columns and rows
ARROWS = (16, 10)
DECENTRING = ("p1", "p2")


def distortion(lens: Intrinsics) -> list[Figure]:
    """Figures of the distortion; none for a model that has none."""
    return [_field(lens), _radial_curve(lens)] if len(lens.distortion) else []


def _errors_known(lens: Intrinsics) -> bool:
    return bool(np.isfinite(lens.covariance).all() and np.diag(lens.covariance).any())


def _ideal_rays(lens: Intrinsics, xy_px: np.ndarray) -> np.ndarray:
    """(N, 3) directions that a lens without distortion would put on these pixels."""
    x = (xy_px[:, 0] - lens.cx_px) / lens.fx_px
    return np.column_stack([-x if lens.mirrored else x, (xy_px[:, 1] - lens.cy_px) / lens.fy_px, np.ones(len(xy_px))])


def _parts(lens: Intrinsics, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (N, 2) px of ideal pixels by the radial terms, and by the decentring terms; NaN beyond the fold."""
    rays = _ideal_rays(lens, xy_px)
    straight = np.where(np.isin(DISTORTION_NAMES[lens.model], DECENTRING), 0.0, lens.distortion)
    radial = projection.project(dataclasses.replace(lens, distortion=straight), rays)
    return radial - xy_px, projection.project(lens, rays) - radial


def _field(lens: Intrinsics) -> Figure:
    size_px = lens.image_size_px
    made, both = sensor_sheet(size_px, wide=True, columns=2)
    fine, coarse = grid_px(size_px, *FIELD), grid_px(size_px, *ARROWS, inset_px=size_px[0] / 30)
    names = [name for name in DISTORTION_NAMES[lens.model] if name not in DECENTRING]
    titles = (f"radial terms ({', '.join(names)})", "tangential terms (p1, p2)")
    said = []
    for axes, shift, arrows, title in zip(both, _parts(lens, fine), _parts(lens, coarse), titles, strict=True):
        size = np.hypot(*shift.T)
        largest = int(np.nanargmax(size))
        sensor_field(axes, size.reshape(FIELD[::-1]), size_px, "displacement (px)", title=title)
        axes.quiver(*coarse.T, *arrows.T, angles="xy", color="white", width=0.0028, pivot="tail")
        axes.plot(lens.cx_px, lens.cy_px, "+", color="white", markersize=9)
        x, y = fine[largest]
        said.append(f"{title} up to {number(size[largest], 3)} px, at pixel ({x:.0f}, {y:.0f})")
    return Figure(title="Distortion: where the lens puts an ideal pixel", png=png(made), wide=True,
                  reading=sentence(*said, "arrows on a scale of their own in each panel, the cross is the principal point"))


def _radial_curve(lens: Intrinsics) -> Figure:
    """Displacement along a radius by the radial terms, with the error that their covariance gives."""
    w, h = lens.image_size_px
    corners = np.array([[0, 0], [w - 1, 0], [0, h - 1], [w - 1, h - 1]]) - [lens.cx_px, lens.cy_px]
    largest = min(float(np.hypot(*(corners / [lens.fx_px, lens.fy_px]).T).max()), 0.999 * projection.fold_radius(lens))
    tangent = np.linspace(0, largest, 121)
    angle = np.degrees(np.arctan(tangent))
    names = DISTORTION_NAMES[lens.model]
    straight = dataclasses.replace(lens, mirrored=False, distortion=np.where(np.isin(names, DECENTRING), 0.0, lens.distortion))
    rays = np.column_stack([tangent, np.zeros_like(tangent), np.ones_like(tangent)])
    xy, _, by_parameter = projection.project_with_jacobian(straight, rays)
    shift = xy[:, 0] - lens.cx_px - lens.fx_px * tangent
    terms = [i for i, name in enumerate(lens.parameter_names) if name in names and name not in DECENTRING]
    slope = by_parameter[:, 0, terms]
    covariance = lens.covariance[np.ix_(terms, terms)]
    error = np.sqrt(np.einsum("ni,ij,nj->n", slope, covariance, slope)) if _errors_known(lens) else None
    made, (axes,) = sheet(HALF)
    axes.axhline(0, color=GREY, linewidth=0.7)
    if error is not None:
        axes.fill_between(angle, shift - 3 * error, shift + 3 * error, color=BLUE, alpha=0.16, linewidth=0, label="±3σ")
        axes.fill_between(angle, shift - error, shift + error, color=BLUE, alpha=0.3, linewidth=0, label="±1σ")
    axes.plot(angle, shift, color=BLUE, label="radial displacement")
    half_width = float(np.degrees(np.arctan(w / 2 / lens.fx_px)))
    axes.axvline(half_width, color=GREY, linestyle=":", linewidth=1, label="edge at mid height")
    axes.grid(color=FAINT)
    axes.set(xlabel="field angle from the optical axis (degrees)", ylabel="displacement from ideal (px)", xlim=(0, angle[-1]))
    axes.legend(loc="best")
    kind = "Barrel (inwards)" if shift[-1] < 0 else "Pincushion (outwards)"
    at_corner = with_uncertainty(shift[-1], error[-1]) if error is not None else number(shift[-1])
    return Figure(title="Radial distortion against field angle", png=png(made),
                  reading=f"{kind}: {at_corner} px at {angle[-1]:.1f} degrees, the farthest corner, "
                          f"{percent(shift[-1] / (lens.fx_px * tangent[-1]))} of the radius there.")


def projection_sd_px(lens: Intrinsics, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1-sigma (N,) px, rms of both axes, of the projection of stars.

    The first as the covariance gives it; the second with the turn of the camera that fits the field best taken out, since an
    attitude fitted to the same stars takes it up.
    """
    rays = _ideal_rays(lens, xy_px)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    _, by_ray, by_parameter = projection.project_with_jacobian(lens, rays)
    seen = np.isfinite(by_ray).all((1, 2))
    by_turn = (by_ray @ -rotation.skew(rays))[seen].reshape(-1, 3)
    flat = by_parameter[seen].reshape(len(by_turn), -1)
    rest = flat - by_turn @ np.linalg.lstsq(by_turn, flat, rcond=None)[0]

    def sd(slope: np.ndarray) -> np.ndarray:
        out = np.full(len(xy_px), np.nan)
        variance = np.einsum("ki,ij,kj->k", slope, lens.covariance, slope).reshape(-1, 2)
        out[seen] = np.sqrt(variance.sum(1) / 2)
        return out
    return sd(flat), sd(rest)


def uncertainty(lens: Intrinsics) -> Figure | None:
    """Two maps of the projection's 1-sigma; None where the covariance is not known."""
    if not _errors_known(lens):
        return None
    size_px = lens.image_size_px
    made, both = sensor_sheet(size_px, wide=True, columns=2)
    arcsec_per_px = float(np.degrees(1 / lens.fx_px)) * 3600
    said = []
    titles = ("all of it", "after the best common turn of the camera")
    xy_px = grid_px(size_px, *FIELD)
    for axes, sd, title in zip(both, projection_sd_px(lens, xy_px), titles, strict=True):
        field = sd.reshape(FIELD[::-1])
        sensor_field(axes, field, size_px, "1σ of the projection, each axis (px)", title=title)
        x, y = xy_px.T.reshape(2, *FIELD[::-1])
        lines = axes.contour(x, y, field, levels=5, colors="white", linewidths=0.6)
        axes.clabel(lines, fontsize=7, fmt="%.3g")
        middle, worst = np.nanmedian(sd), np.nanmax(sd)
        said.append(f"{title}: median {number(middle, 2)} px ({number(middle * arcsec_per_px, 2)} arcsec), worst "
                    f"{number(worst, 2)} px ({number(worst * arcsec_per_px, 2)} arcsec)")
    return Figure(title="Uncertainty of the projection of stars (at infinity), 1σ", png=png(made), wide=True,
                  reading=sentence(*said, "what a common turn takes up goes into the attitude, the rest stays in the stars"))
