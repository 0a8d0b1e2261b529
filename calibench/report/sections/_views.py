"""What each view of the board says: where the board stood, its table from the worst view down, residuals view by view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import rotation
from ...records import Intrinsics, Measurement
from ..draw import (
    BELOW_IN,
    BLUE,
    FAINT,
    GREY,
    HALF,
    INK,
    LABELS_IN,
    ORANGE,
    TALLEST_IN,
    TITLE_IN,
    WIDE,
    png,
    sensor_axes,
    sensor_sheet,
    sheet,
)
from ..numbers import fixed, number, plural, sentence
from ..section import Figure, Table

MOST_NAMED_VIEWS = 40
GREYS = 16  # steps of a picture: finer ones make large files
ARROW_SHARE = 0.08  # of the image's width: a long residual among the worst views
NEEDED = {"poses", "corners_view", "corners_board_mm", "residual_px", "inlier", "view_rms_px"}


@dataclass(frozen=True, kw_only=True)
class _Stands:
    """The board in camera axes: outline_mm (V, 4, 3), centre_mm (V, 3), tilt_rad (V,) of its normal from the optical axis."""

    outline_mm: np.ndarray
    centre_mm: np.ndarray
    tilt_rad: np.ndarray

    @property
    def distance_mm(self) -> np.ndarray:
        return np.linalg.norm(self.centre_mm, axis=1)


def _stands(measurement: Measurement) -> _Stands | None:
    """Where the board stood in each view; None where the evidence does not say."""
    evidence = measurement.evidence
    if not evidence.keys() >= NEEDED:
        return None
    turn, shift_mm = rotation.matrix_from_rotvec(evidence["poses"][:, :3]), evidence["poses"][:, None, 3:]
    (x0, y0), (x1, y1) = (f(evidence["corners_board_mm"][:, :2], axis=0) for f in (np.min, np.max))
    outline_mm = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]]) @ np.swapaxes(turn, 1, 2) + shift_mm
    return _Stands(outline_mm=outline_mm, centre_mm=outline_mm.mean(axis=1),
                   tilt_rad=np.arccos(np.minimum(np.abs(turn[:, 2, 2]), 1)))


def names(measurement: Measurement) -> list[str]:
    """File names of the views, without folder and suffix; their numbers where no files are known."""
    files = measurement.provenance.settings.get("views", range(1, len(measurement.evidence["view_rms_px"]) + 1))
    return [str(file).replace("\\", "/").rsplit("/", 1)[-1].rsplit(".", 1)[0] for file in files]


def listing(measurement: Measurement) -> Table | None:
    """One row a view, the largest rms first."""
    stands = _stands(measurement)
    if stands is None:
        return None
    evidence, named = measurement.evidence, names(measurement)
    rms, inlier = evidence["view_rms_px"], evidence["inlier"].astype(bool)
    used, out = (np.bincount(evidence["corners_view"][chosen], minlength=len(rms)) for chosen in (inlier, ~inlier))
    largest = np.zeros(len(rms))
    np.maximum.at(largest, evidence["corners_view"], np.hypot(*evidence["residual_px"].T))
    order = np.argsort(-rms)[:MOST_NAMED_VIEWS]
    unseen, effect = (evidence.get(name, np.full(len(rms), np.nan)) for name in ("view_left_out_rms_px", "view_effect_sd"))
    rows = tuple((named[i], str(used[i]), str(out[i]), *(number(x[i], 3) for x in (rms, largest, unseen)), number(effect[i], 2),
                  fixed(np.degrees(stands.tilt_rad[i]), 1), fixed(stands.distance_mm[i], 0)) for i in order)
    columns = ("View", "Corners used", "Left out", "rms (px)", "Largest residual (px)", "rms unseen (px)", "Effect (σ)",
               "Tilt (degrees)", "Distance (mm)")
    shown = f"the worst {len(order)} of {len(rms)} views" if len(order) < len(rms) else f"all {plural(len(rms), 'view')}"
    return Table(title="Views, worst first", columns=columns, rows=rows, numbers=frozenset(columns[1:]),
                 note=sentence(f"{shown}; rms and largest residual over all corners, those left out included",
                               "unseen: over inliers, under the lens of the other views",
                               "effect: how far the image's corners move when the view is left out, in their uncertainty",
                               "tilt: the board's normal against the optical axis",
                               "distance: from the camera to the middle of the board"))


def board_poses(measurement: Measurement) -> Figure | None:
    """The boards in camera axes, seen from above and from the side, with the edges of the field."""
    stands = _stands(measurement)
    if stands is None:
        return None
    rms = measurement.evidence["view_rms_px"]
    worst = int(np.argmax(rms))
    depth_mm = 1.06 * stands.outline_mm[..., 2].max()
    reach_mm = 1.1 * np.abs(stands.outline_mm[..., :2]).max()
    panel_in = WIDE[0] / 2 - LABELS_IN
    made, both = sheet((WIDE[0], min(panel_in * 2 * reach_mm / depth_mm + BELOW_IN + TITLE_IN, TALLEST_IN)), columns=2)
    for axis, axes in enumerate(both):
        for view in sorted(range(len(rms)), key=lambda view: view == worst):
            colour = ORANGE if view == worst else BLUE
            axes.fill(stands.outline_mm[view, :, 2], stands.outline_mm[view, :, axis], facecolor=colour, alpha=0.12)
            axes.fill(stands.outline_mm[view, :, 2], stands.outline_mm[view, :, axis], fill=False, edgecolor=colour,
                      linewidth=1.8 if view == worst else 0.9)
        for slope in _field_edges(measurement.intrinsics)[axis]:
            axes.plot([0, depth_mm], [0, depth_mm * slope], color=GREY, linestyle=":", linewidth=1)
        axes.plot(0, 0, "o", color=INK, markersize=5)
        axes.grid(color=FAINT)
        axes.set(aspect="equal", xlabel="depth z along the optical axis (mm)", xlim=(-0.04 * depth_mm, depth_mm),
                 ylim=(reach_mm, -reach_mm), ylabel=("x, to the right (mm)", "y, down (mm)")[axis])
        axes.set_title(("from above", "from the side")[axis])
    tilt, distance_mm = np.degrees(stands.tilt_rad), stands.distance_mm
    return Figure(title="Where the board stood, in camera axes", png=png(made), wide=True,
                  reading=sentence(f"{plural(len(rms), 'view')} at {number(distance_mm.min(), 3)} to "
                                   f"{number(distance_mm.max(), 3)} mm, tilted by {fixed(tilt.min(), 1)} to "
                                   f"{fixed(tilt.max(), 1)} degrees (median {fixed(np.median(tilt), 1)})",
                                   f"orange: the worst view, {names(measurement)[worst]}, at "
                                   f"{number(distance_mm[worst], 3)} mm and {fixed(tilt[worst], 1)} degrees",
                                   "dot: the camera, dotted: the edges of its field without distortion"))


def _field_edges(lens: Intrinsics) -> np.ndarray:
    """(2, 2): x/z at the left and right edge, y/z at the top and bottom one, of a lens without distortion."""
    at = [lens.cx_px, lens.cy_px]
    edges = np.column_stack([-np.array(at), np.array(lens.image_size_px) - 1 - at]) / [[lens.fx_px], [lens.fy_px]]
    if lens.is_fisheye:
        edges = np.tan(np.clip(edges, -1.4, 1.4))
    return edges * [[-1 if lens.mirrored else 1], [1]]


def worst(measurement: Measurement) -> Figure | None:
    """Small pictures of the worst views, with their corners and residuals."""
    evidence = measurement.evidence
    if not evidence.keys() >= NEEDED | {"worst_views", "worst_views_picture"}:
        return None
    chosen, named, (w, h) = evidence["worst_views"], names(measurement), measurement.image_size_px
    view, xy, residual, inlier = (evidence[n] for n in ("corners_view", "corners_xy_px", "residual_px", "inlier"))
    shown = np.isin(view, chosen)
    scale = ARROW_SHARE * w / max(np.percentile(np.hypot(*residual[shown].T), 95), 1e-9)
    made, panels = sensor_sheet((w, h), wide=True, columns=len(chosen), bars=False)
    for axes, i, picture in zip(panels, chosen, evidence["worst_views_picture"], strict=True):
        sensor_axes(axes, (w, h), f"{named[i]}: {number(evidence['view_rms_px'][i], 3)} px")
        axes.imshow(picture // GREYS * GREYS, extent=(-0.5, w - 0.5, h - 0.5, -0.5), cmap="gray", alpha=0.75)
        for those, colour in ((inlier.astype(bool), BLUE), (~inlier.astype(bool), ORANGE)):
            here = those & (view == i)
            axes.quiver(*xy[here].T, *residual[here].T, color=colour, angles="xy", scale_units="xy", scale=1 / scale,
                        width=0.006)
            axes.plot(*xy[here].T, ".", color=colour, markersize=3)
    return Figure(title=f"The worst views, residuals drawn ×{number(scale, 2)}", png=png(made), wide=True,
                  reading=sentence(f"the {len(chosen)} of largest rms among {plural(len(evidence['view_rms_px']), 'view')}, "
                                   f"longest residual {number(np.hypot(*residual[shown].T).max(), 2)} px",
                                   "dots: corners found, arrows: measured minus projected, orange: left out",
                                   "arrows in swirls: a bent board or blur; at random: noise; a few long ones: something "
                                   "covers the board"))


def residuals(measurement: Measurement) -> Figure | None:
    """Bars: the rms of each view."""
    rms = measurement.evidence.get("view_rms_px")
    if rms is None:
        return None
    named = names(measurement)
    made, (axes,) = sheet(HALF)
    worst, median = int(np.argmax(rms)), np.median(rms)
    axes.bar(range(len(rms)), rms, color=[ORANGE if i == worst else BLUE for i in range(len(rms))], width=0.7)
    axes.axhline(median, color=GREY, linestyle="--", linewidth=1, label=f"median {number(median, 3)} px")
    if len(rms) <= MOST_NAMED_VIEWS:
        axes.set_xticks(range(len(rms)), named, rotation=60, ha="right", rotation_mode="anchor", fontsize=7)
    axes.grid(axis="y", color=FAINT)
    axes.set(xlabel="view", ylabel="rms of the residuals (px)", ylim=(0, 1.18 * rms.max()))
    axes.legend(loc="upper right")
    return Figure(title="Residual of each view", png=png(made),
                  reading=f"The worst view, {named[worst]}, has {number(rms[worst], 3)} px, "
                          f"{number(rms[worst] / median, 2)} times the median of "
                          f"{number(median, 3)} px (all corners, outliers included).")
