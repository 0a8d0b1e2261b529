"""Intrinsics: the lens's figures with both error bars, its distortion, and how well the views support them."""

from __future__ import annotations

import numpy as np

from ...measure.intrinsics import CANDIDATE_MODELS
from ...records import Intrinsics, Measurement
from ..draw import BLUE, INK, ORANGE, OUTLINED, png, sensor_axes, sensor_sheet
from ..numbers import ARCSEC, MISSING, number, percent, plural, rounded_like, sentence, sigma
from ..section import Figure, Section, Table
from ..story import Story
from ..tables import quantity_table
from . import _lens, _views

ORDER = 20
TITLE = "Lens: intrinsics"
QUIVER_SHARE = 0.06  # of the image's width: the length of a typical residual's arrow


def render(story: Story) -> Section | None:
    measurement = story.measurements.get("intrinsics")
    if measurement is None or measurement.intrinsics is None:
        return None
    lens = measurement.intrinsics
    others = [q for q in measurement.quantities if q.name not in lens.parameter_names]
    figures = [*_lens.distortion(lens), _views.board_poses(measurement), _coverage(measurement), _residuals(measurement),
               _views.residuals(measurement), _views.worst(measurement), _lens.uncertainty(lens)]
    tables = (_parameters(lens, measurement), quantity_table("How well the lens fits", others), _held_out(lens, measurement),
              _views.listing(measurement))
    return Section(paragraphs=(_summary(lens, measurement),), warnings=measurement.warnings,
                   tables=tuple(t for t in tables if t is not None),
                   figures=tuple(f for f in figures if f is not None))


def _summary(lens: Intrinsics, measurement: Measurement) -> str:
    w, h = lens.image_size_px
    fov = np.degrees(2 * np.arctan([w / 2 / lens.fx_px, h / 2 / lens.fy_px]))
    return (f"Model {lens.model}, from {plural(measurement.frames_used, 'view')}. One pixel at the optical axis is "
            f"{number(ARCSEC / lens.fx_px)} arcsec; without distortion the field would be {fov[0]:.2f} × {fov[1]:.2f} degrees. "
            "The recommended uncertainty is clustered by view: corners of one view do not err independently, which the "
            "classical one assumes.")


def _parameters(lens: Intrinsics, measurement: Measurement) -> Table:
    clustered = np.sqrt(np.diag(lens.covariance))
    classical = measurement.evidence.get("uncertainty_classical", np.full(len(clustered), np.nan))
    rows = []
    for name, value, recommended, plain in zip(lens.parameter_names, lens.parameters, clustered, classical, strict=False):
        ratio = recommended / plain if plain > 0 else np.nan
        rows.append((name.removesuffix("_px"), rounded_like(value, recommended), sigma(recommended), sigma(recommended, 3),
                     sigma(plain), number(ratio, 2), "px" if name.endswith("_px") else ""))
    columns = ("Parameter", "Value", "1σ clustered", "3σ clustered", "1σ classical", "Clustered / classical", "Unit")
    return Table(title="Lens parameters", columns=columns, rows=tuple(rows), numbers=frozenset(columns[1:6]))


def _held_out(lens: Intrinsics, measurement: Measurement) -> Table | None:
    """Training rms against the held-out rms of each model; None where no views were held out."""
    given = {q.name: q.value for q in measurement.quantities}
    training, held_out, left_out = (given.get(n) for n in ("rms_px", "held_out_rms_px", "leave_one_out_rms_px"))
    by_model = measurement.evidence.get("held_out_rms_by_model_px")
    if by_model is None or not training or not held_out:
        return None
    trained = measurement.evidence.get("training_rms_by_model_px", np.full(len(by_model), np.nan))
    all_px = {**dict(zip(CANDIDATE_MODELS, zip(trained, by_model, strict=True), strict=True)), lens.model: (training, held_out)}
    rows = tuple((f"{model} (used)" if model == lens.model else model, number(fitted), number(unseen), number(unseen / fitted),
                  number(unseen / held_out)) for model, (fitted, unseen) in all_px.items())
    columns = ("Model", "Training rms (px)", "Held-out rms (px)", "Held-out / training", "Held-out / the used model's")
    return Table(title="Training against held-out views", columns=columns, rows=rows, numbers=frozenset(columns[1:]),
                 note=sentence("corners of views that the lens has not seen are missed by "
                               f"{number(held_out / training, 3)} times the training rms of {lens.model}",
                               "each half of the views is held out in turn, only its poses are fitted",
                               f"with one view at a time held out: {number(left_out, 3)} px" if left_out else "",
                               f"{MISSING}: not determined by half of the views"))


def _coverage(measurement: Measurement) -> Figure | None:
    corners = measurement.evidence.get("corners_xy_px")
    count = measurement.evidence.get("coverage_count")
    if corners is None or count is None:
        return None
    w, h = measurement.image_size_px
    made, (axes,) = sensor_sheet((w, h), bars=False)
    sensor_axes(axes, (w, h))
    rows, columns = count.shape
    axes.imshow(count, extent=(-0.5, w - 0.5, h - 0.5, -0.5), cmap="Blues", alpha=0.45, vmin=0, interpolation="nearest")
    axes.plot(*corners.T, ".", color=BLUE, markersize=2.2, alpha=0.45)
    for row, column in np.ndindex(rows, columns):
        empty = count[row, column] == 0
        axes.text((column + 0.5) * w / columns - 0.5, (row + 0.5) * h / rows - 0.5, str(count[row, column]), ha="center",
                  va="center", fontsize=8, fontweight="bold", color=ORANGE if empty else INK, path_effects=OUTLINED)
    filled = int((count > 0).sum())
    middle = np.array([w - 1, h - 1]) / 2
    radius = np.hypot(*(corners - middle).T).max() / np.hypot(*middle)
    return Figure(title="Coverage of the image by corners", png=png(made),
                  reading=sentence(f"{len(corners)} corners fill {filled} of {count.size} cells (numbers: corners a cell)",
                                   f"the outermost lies at {percent(radius)} of the half diagonal",
                                   "" if filled == count.size else "the lens is extrapolated in the empty cells"))


def _residuals(measurement: Measurement) -> Figure | None:
    evidence = measurement.evidence
    if not {"corners_xy_px", "residual_px", "inlier"} <= evidence.keys():
        return None
    xy, residual, inlier = evidence["corners_xy_px"], evidence["residual_px"], evidence["inlier"].astype(bool)
    length = np.hypot(*residual.T)
    outliers = np.count_nonzero(~inlier)
    scale = QUIVER_SHARE * measurement.image_size_px[0] / max(np.percentile(length[inlier], 95), 1e-9)
    made, (axes,) = sensor_sheet(measurement.image_size_px, bars=False)
    sensor_axes(axes, measurement.image_size_px)
    arrows = {"angles": "xy", "scale_units": "xy", "scale": 1 / scale, "width": 0.0022}
    axes.quiver(*xy[inlier].T, *residual[inlier].T, color=BLUE, **arrows)
    axes.plot(*xy[~inlier].T, "x", color=ORANGE, markersize=6)
    return Figure(title=f"Corner residuals, drawn ×{number(scale, 2)}", png=png(made),
                  reading=sentence(f"measured minus projected: median length {number(np.median(length[inlier]), 2)} px, "
                                   f"longest {number(length[inlier].max(), 2)} px",
                                   f"crossed out: {plural(outliers, 'outlier')} among {len(xy)} corners"))
