"""Figures of a lens: its distortion over the field and along a radius, and how uncertain its projection is at infinity."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import BadInput
from ...geometry import projection
from ...geometry.projection_error import direction_covariance
from ...records import DISTORTION_NAMES, Intrinsics
from ..draw import BLUE, FAINT, GREY, HALF, ORANGE, OUTLINED, grid_px, png, sensor_field, sensor_sheet, sheet
from ..numbers import ARCSEC, number, percent, sentence, with_uncertainty
from ..section import Figure

FIELD = (48, 32)  # samples over the image, columns and rows
ARROWS = (16, 10)
CURVE_SAMPLES = 181
SIDEWAYS = ("p1", "p2", "s1", "s2", "s3", "s4")  # decentring and thin prism: what turns with the lens in its mount
TRUSTED_PX = 0.1  # 1-sigma of the projection up to which a pixel counts as trusted


def distortion(lens: Intrinsics) -> list[Figure]:
    """Figures of the distortion; none for a model that has none."""
    return [_field(lens), _radial_curve(lens)] if len(lens.distortion) else []


def _errors_known(lens: Intrinsics) -> bool:
    return bool(np.isfinite(lens.covariance).all() and np.diag(lens.covariance).any())


def _ideal_rays(lens: Intrinsics, xy_px: np.ndarray) -> np.ndarray:
    """(N, 3) directions that the model with all terms zero would put on these pixels; NaN where a fisheye has none.

    Without terms a fisheye is equidistant (the radius is the angle), the other models are pinholes (it is the tangent).
    """
    y = (xy_px[:, 1] - lens.cy_px) / lens.fy_px
    x = (xy_px[:, 0] - lens.cx_px - (lens.skew_px or 0.0) * y) / lens.fx_px
    x = -x if lens.mirrored else x
    if not lens.is_fisheye:
        return np.column_stack([x, y, np.ones(len(xy_px))])
    angle = np.hypot(x, y)
    shrunk = np.where(angle < np.pi, np.sinc(angle / np.pi), np.nan)
    return np.column_stack([x * shrunk, y * shrunk, np.cos(angle)])


def _without(lens: Intrinsics, names: tuple[str, ...]) -> Intrinsics:
    """The lens with these terms zero."""
    return dataclasses.replace(lens, distortion=np.where(np.isin(DISTORTION_NAMES[lens.model], names), 0.0, lens.distortion))


def _parts(lens: Intrinsics, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (N, 2) px of ideal pixels by the radial terms, and by the sideways ones; NaN beyond the fold."""
    rays = _ideal_rays(lens, xy_px)
    radial = projection.project(_without(lens, SIDEWAYS), rays)
    return radial - xy_px, projection.project(lens, rays) - radial


def _field(lens: Intrinsics) -> Figure:
    size_px = lens.image_size_px
    names = DISTORTION_NAMES[lens.model]
    titles = [f"{kind} terms ({', '.join(terms)})" for kind, terms in (
        ("radial", [name for name in names if name not in SIDEWAYS]),
        ("tangential", [name for name in names if name in SIDEWAYS])) if terms]  # a fisheye has radial ones only
    made, panels = sensor_sheet(size_px, wide=len(titles) > 1, columns=len(titles))
    fine, coarse = grid_px(size_px, *FIELD), grid_px(size_px, *ARROWS, inset_px=size_px[0] / 30)
    said = []
    for axes, shift, arrows, title in zip(panels, _parts(lens, fine), _parts(lens, coarse), titles, strict=False):
        size = np.hypot(*shift.T)
        largest = int(np.nanargmax(size))
        sensor_field(axes, size.reshape(FIELD[::-1]), size_px, "displacement (px)", title=title)
        axes.quiver(*coarse.T, *arrows.T, angles="xy", color="white", width=0.0028, pivot="tail")
        axes.plot(lens.cx_px, lens.cy_px, "+", color="white", markersize=9)
        x, y = fine[largest]
        said.append(f"{title} up to {number(size[largest], 3)} px, at pixel ({x:.0f}, {y:.0f})")
    return Figure(title="Distortion: where the lens puts an ideal pixel", png=png(made), wide=len(titles) > 1,
                  reading=sentence(*said, f"ideal is {_ideal(lens)}",
                                   "arrows on a scale of their own in each panel, the cross is the principal point"))


def _ideal(lens: Intrinsics) -> str:
    return "an equidistant fisheye" if lens.is_fisheye else "a pinhole"


def _radial_curve(lens: Intrinsics) -> Figure:
    """Displacement along a radius by the radial terms, with the error that their covariance gives."""
    w, h = lens.image_size_px
    corners = np.array([[0, 0], [w - 1, 0], [0, h - 1], [w - 1, h - 1]]) - [lens.cx_px, lens.cy_px]
    radius = np.linspace(0, float(np.hypot(*(corners / [lens.fx_px, lens.fy_px]).T).max()), CURVE_SAMPLES)
    straight = dataclasses.replace(_without(lens, SIDEWAYS), mirrored=False)
    rays = _ideal_rays(straight, np.column_stack([lens.cx_px + lens.fx_px * radius, np.full_like(radius, lens.cy_px)]))
    xy, _, by_parameter = projection.project_with_jacobian(straight, rays)
    seen = np.isfinite(xy).all(axis=1)
    radius, rays, xy, by_parameter = radius[seen], rays[seen], xy[seen], by_parameter[seen]
    angle = np.degrees(np.arctan2(rays[:, 0], rays[:, 2]))
    shift = xy[:, 0] - lens.cx_px - lens.fx_px * radius
    terms = [i for i, name in enumerate(DISTORTION_NAMES[lens.model], start=4) if name not in SIDEWAYS]
    slope = by_parameter[:, 0, terms]
    covariance = lens.covariance[np.ix_(terms, terms)]
    error = np.sqrt(np.einsum("ni,ij,nj->n", slope, covariance, slope)) if _errors_known(lens) else None
    made, (axes,) = sheet(HALF)
    axes.axhline(0, color=GREY, linewidth=0.7)
    if error is not None:
        axes.fill_between(angle, shift - 3 * error, shift + 3 * error, color=BLUE, alpha=0.16, linewidth=0, label="±3σ")
        axes.fill_between(angle, shift - error, shift + error, color=BLUE, alpha=0.3, linewidth=0, label="±1σ")
    axes.plot(angle, shift, color=BLUE, label="radial displacement")
    half_width = float(np.degrees(w / 2 / lens.fx_px if lens.is_fisheye else np.arctan(w / 2 / lens.fx_px)))
    axes.axvline(half_width, color=GREY, linestyle=":", linewidth=1, label="edge at mid height")
    axes.grid(color=FAINT)
    axes.set(xlabel="field angle from the optical axis (degrees)", ylabel="displacement from ideal (px)", xlim=(0, angle[-1]))
    axes.legend(loc="best")
    kind = "Barrel (inwards)" if shift[-1] < 0 else "Pincushion (outwards)"
    at_corner = with_uncertainty(shift[-1], error[-1]) if error is not None else number(shift[-1])
    where = "the farthest corner" if seen.all() else "where the model folds, short of the farthest corner"
    return Figure(title="Radial distortion against field angle", png=png(made),
                  reading=f"{kind}, against {_ideal(lens)}: {at_corner} px at {angle[-1]:.1f} degrees, {where}, "
                          f"{percent(shift[-1] / (lens.fx_px * radius[-1]))} of the radius there.")


def projection_sd_px(lens: Intrinsics, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1-sigma (N,) px, rms of both axes, of the projection of stars onto these pixels.

    The first as the covariance gives it; the second with the turn of the camera that fits the field best taken out, since an
    attitude fitted to the same stars takes it up. NaN for pixels that have no direction, beyond the fold of the model.
    """
    seen = np.array([_has_direction(lens, xy) for xy in xy_px])
    _, by_ray, by_parameter = projection.project_with_jacobian(lens, projection.unproject(lens, xy_px[seen]))

    def sd(slope: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        out = np.full(len(xy_px), np.nan)
        out[seen] = np.sqrt(((slope @ covariance) * slope).sum((1, 2)) / 2)
        return out
    return sd(by_parameter, lens.covariance), sd(by_ray, direction_covariance(lens, xy_px[seen]))


def _has_direction(lens: Intrinsics, xy_px: np.ndarray) -> bool:
    try:
        projection.unproject(lens, xy_px[None])
    except BadInput:
        return False
    return True


def uncertainty(lens: Intrinsics) -> Figure | None:
    """Two maps of the projection's 1-sigma, the trusted region outlined; None where the covariance is not known."""
    if not _errors_known(lens):
        return None
    size_px = lens.image_size_px
    made, both = sensor_sheet(size_px, wide=True, columns=2)
    arcsec_per_px = ARCSEC / lens.fx_px
    said = []
    titles = ("all of it", "after the best common turn of the camera")
    xy_px = grid_px(size_px, *FIELD)
    for axes, sd, title in zip(both, projection_sd_px(lens, xy_px), titles, strict=True):
        field = sd.reshape(FIELD[::-1])
        sensor_field(axes, field, size_px, "1σ of the projection, each axis (px)", title=title)
        x, y = xy_px.T.reshape(2, *FIELD[::-1])
        lines = axes.contour(x, y, field, levels=5, colors="white", linewidths=0.6)
        axes.clabel(lines, fontsize=7, fmt="%.3g")
        bounded = np.nanmin(sd) < TRUSTED_PX < np.nanmax(sd)
        if bounded:
            edge = axes.contour(x, y, field, levels=[TRUSTED_PX], colors=ORANGE, linewidths=2)
            for label in axes.clabel(edge, fontsize=8, fmt=f"{TRUSTED_PX:g} px", colors=ORANGE):
                label.set_path_effects(OUTLINED)
        typical, worst = np.nanmedian(sd), np.nanmax(sd)
        said.append(f"{title}: median {number(typical, 2)} px ({number(typical * arcsec_per_px, 2)} arcsec), worst "
                    f"{number(worst, 2)} px ({number(worst * arcsec_per_px, 2)} arcsec), trusted (1σ up to {TRUSTED_PX:g} px"
                    f"{', orange line' if bounded else ''}) {percent(np.mean(sd <= TRUSTED_PX))} of the image")
    return Figure(title="Uncertainty of the projection of stars (at infinity), 1σ", png=png(made), wide=True,
                  reading=sentence(*said, "what a common turn takes up goes into the attitude, the rest stays in the stars"))
