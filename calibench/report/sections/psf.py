"""PSF: size and shape of a point's image over the field."""

from __future__ import annotations

import numpy as np
from matplotlib.patches import Ellipse

from ...records import Measurement, PsfMap
from ...spots.psf import FWHM_PER_SIGMA, light, moments_at
from ..draw import BLUE, FAINT, HALF, ORANGE, SEQUENTIAL, WIDE, grid_px, png, sensor_axes, sensor_field, sensor_sheet, sheet
from ..numbers import number, percent, plural
from ..section import Figure, Section
from ..story import Story
from ..tables import quantity_table
from ._psf_series import focus_figure, stars_figure
from ._spot_bias import bias_figure

ORDER = 50
TITLE = "Point spread function"
FIELD, ELLIPSES = (61, 41), (12, 8)
PLACES = ((0.0, "centre"), (0.35, "35 % out"), (0.6, "60 % out"), (0.8, "80 % out"), (0.97, "corner"))
STAMP_PX, OVERSAMPLING = 11, 9
ROUND = 0.1


def render(story: Story) -> Section | None:
    measurement = story.measurements.get("psf")
    if measurement is None or measurement.psf is None:
        return None
    psf = measurement.psf
    figures = (_ellipses(psf), _width(psf), _ellipticity(psf), _stamps(psf), _encircled(measurement), bias_figure(psf),
               focus_figure(measurement), stars_figure(measurement), _residuals(measurement))
    spots = plural(len(psf.measured_xy_px), "spot")
    summary = (f"Moments as a polynomial of degree {psf.degree} over the field, from {spots}; "
               f"they scatter about it by {number(psf.residual_rms_px2, 2)} px² (rms). A centroid through this map means: "
               f"{psf.centre}. Widths are those of the light before the pixel integrates it.")
    return Section(paragraphs=(summary,), warnings=measurement.warnings,
                   tables=(quantity_table("PSF figures", measurement.quantities),),
                   figures=tuple(f for f in figures if f is not None))


def shape(psf: PsfMap, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Major and minor sigma (N,) px and the major axis's angle (N,) rad from x towards y (down)."""
    s_xx, s_yy, s_xy = moments_at(psf, xy_px).T
    middle, half = (s_xx + s_yy) / 2, np.hypot((s_xx - s_yy) / 2, s_xy)
    return np.sqrt(middle + half), np.sqrt(np.maximum(middle - half, 0)), np.arctan2(2 * s_xy, s_xx - s_yy) / 2


def _ellipses(psf: PsfMap) -> Figure:
    w, h = psf.image_size_px
    xy = grid_px(psf.image_size_px, *ELLIPSES, inset_px=w / 30)
    major, minor, angle = shape(psf, xy)
    scale = 0.4 * w / ELLIPSES[0] / (FWHM_PER_SIGMA / 2 * major.max())
    made, (axes,) = sensor_sheet(psf.image_size_px, bars=False)
    sensor_axes(axes, psf.image_size_px)
    axes.plot(*psf.measured_xy_px.T, ".", color=ORANGE, markersize=2, alpha=0.7)
    for (x, y), a, b, turn in zip(xy, major, minor, angle, strict=True):
        wide, narrow = FWHM_PER_SIGMA * scale * np.array([a, b])
        axes.add_patch(Ellipse((x, y), wide, narrow, angle=np.degrees(turn), facecolor="none", edgecolor=BLUE, linewidth=1))
    from_centre = xy - np.array([w - 1, h - 1]) / 2
    outer = np.hypot(*from_centre.T) > w / 3
    radius_angle = np.arctan2(from_centre[:, 1], from_centre[:, 0])
    radial = np.abs(np.cos(angle - radius_angle)) > np.cos(np.pi / 4)
    return Figure(title=f"PSF over the field (ellipses of half maximum, ×{number(scale, 2)})", png=png(made),
                  reading=f"Axes from {number(FWHM_PER_SIGMA * minor.min(), 3)} to {number(FWHM_PER_SIGMA * major.max(), 3)} "
                          f"px; in the outer field {percent(radial[outer].mean())} of the ellipses point along the radius "
                          "rather than across it. Dots: spots used.")


def _width(psf: PsfMap) -> Figure:
    xy = grid_px(psf.image_size_px, *FIELD)
    major, minor, _ = shape(psf, xy)
    fwhm = FWHM_PER_SIGMA * np.sqrt(major * minor)
    made, (axes,) = sensor_sheet(psf.image_size_px)
    sensor_field(axes, fwhm.reshape(FIELD[::-1]), psf.image_size_px, "FWHM, geometric mean of the axes (px)")
    (x, y), (far_x, far_y) = xy[np.argmin(fwhm)], xy[np.argmax(fwhm)]
    return Figure(title="Width over the field", png=png(made),
                  reading=f"Sharpest at pixel ({x:.0f}, {y:.0f}) with {number(fwhm.min(), 3)} px, widest at ({far_x:.0f}, "
                          f"{far_y:.0f}) with {number(fwhm.max(), 3)} px; median {number(np.median(fwhm), 3)} px.")


def _ellipticity(psf: PsfMap) -> Figure:
    xy = grid_px(psf.image_size_px, *FIELD)
    major, minor, _ = shape(psf, xy)
    flattening = 1 - minor / major
    made, (axes,) = sensor_sheet(psf.image_size_px)
    sensor_field(axes, flattening.reshape(FIELD[::-1]), psf.image_size_px, "ellipticity 1 − b/a")
    coarse = grid_px(psf.image_size_px, 16, 10, inset_px=psf.image_size_px[0] / 30)
    a, b, turn = shape(psf, coarse)
    whisker = (1 - b / a)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    axes.quiver(*coarse.T, *whisker.T, angles="xy", pivot="middle", headaxislength=0, headlength=0, headwidth=1, color="white",
                width=0.005)
    x, y = xy[np.argmax(flattening)]
    return Figure(title="Ellipticity over the field (whiskers: major axis)", png=png(made),
                  reading=f"Median {number(np.median(flattening), 2)}, largest {number(flattening.max(), 2)} at pixel "
                          f"({x:.0f}, {y:.0f}); {percent((flattening < ROUND).mean())} of the field is rounder than {ROUND:g}.")


def _stamps(psf: PsfMap) -> Figure:
    """A point's image from the centre to the lower right corner: from the side (cut along the row), and from the top."""
    w, h = psf.image_size_px
    xy = np.array([[(w - 1) / 2 * (1 + share), (h - 1) / 2 * (1 + share)] for share, _ in PLACES])
    pixels, fine = (np.arange(n * STAMP_PX) / n - (STAMP_PX - 1 / n) / 2 for n in (1, OVERSAMPLING))
    images = [light(psf, at, pixels, pixels) for at in xy]
    cuts = [light(psf, at, fine, np.zeros(1))[0] for at in xy]
    peaks = [image.max() for image in images]
    made, grid = sheet((WIDE[0], 4.4), len(PLACES), 2)
    half = STAMP_PX / 2
    for i, ((_, name), (x, y), image, cut) in enumerate(zip(PLACES, xy, images, cuts, strict=True)):
        side, top = grid[i], grid[len(PLACES) + i]
        side.bar(pixels, 100 * image[STAMP_PX // 2], width=0.9, color=FAINT)
        side.plot(fine, 100 * cut, color=BLUE)
        side.set(title=f"{name}, ({x:.0f}, {y:.0f})", xlim=(-half, half), ylim=(0, 105 * max(peaks)))
        drawn = top.imshow(100 * image, extent=(-half, half, half, -half), cmap=SEQUENTIAL, vmin=0, vmax=100 * max(peaks))
        top.set(xlabel="x (px)", ylabel="y (px)" if i == 0 else "")
    grid[0].set_ylabel("light a pixel (%)")
    made.colorbar(drawn, ax=list(grid[len(PLACES):]), pad=0.01, aspect=24).set_label("light a pixel (%)")
    return Figure(title="A point's image from the centre to a corner, from the side and from the top, as the map has it",
                  png=png(made), wide=True,
                  reading=f"A star centred on a pixel puts {percent(peaks[0])} of its light into it at the centre of the image "
                          f"and {percent(peaks[-1])} at the corner. Line: share of a pixel at any place.")


def _residuals(measurement: Measurement) -> Figure | None:
    """Held-out error by order and degree: what the choice of the shape rests on."""
    tried, chi2 = (measurement.evidence.get(name) for name in ("held_out_order_degree", "held_out_chi2"))
    if tried is None or chi2 is None:
        return None
    made, (axes,) = sheet(HALF)
    for order, colour in zip(np.unique(tried[:, 0]), (ORANGE, BLUE, "black"), strict=False):
        rows = tried[:, 0] == order
        axes.plot(tried[rows, 1], chi2[rows], "o-", color=colour, label=f"order {order}")
    axes.set(xlabel="degree over the field", ylabel="chi² per pixel of left-out spots", xticks=np.unique(tried[:, 1]),
             yscale="log")
    axes.grid(color=FAINT)
    axes.legend()
    best = np.argmin(chi2)
    return Figure(title="Choice of the shape: error of spots that were left out", png=png(made),
                  reading=f"Least with order {tried[best, 0]} and degree {tried[best, 1]}: {number(chi2[best], 4)} per pixel "
                          "(1 is noise alone).")


def _encircled(measurement: Measurement) -> Figure | None:
    radius, share = (measurement.evidence.get(name) for name in ("encircled_radius_px", "encircled_fraction"))
    if radius is None or share is None:
        return None
    made, (axes,) = sheet(HALF)
    axes.plot(radius, 100 * share, color=BLUE)
    ee50, ee80 = (float(np.interp(level, np.maximum.accumulate(share), radius)) for level in (0.5, 0.8))
    for level, r in ((50, ee50), (80, ee80)):
        axes.plot([0, r, r], [level, level, 0], color=ORANGE, linewidth=1, linestyle="--")
        axes.annotate(f"EE{level}: {number(r, 3)} px", (r, level), textcoords="offset points", xytext=(7, -9))
    axes.set(xlabel="radius (px)", ylabel="light within the radius (%)", xlim=(0, float(radius[-1])), ylim=(0, 104))
    axes.grid(color=FAINT)
    return Figure(title="Encircled light, mean of all spots, pixel included", png=png(made),
                  reading=f"Half of the light lies within {number(ee50, 3)} px of the spot's centre, 80 % within "
                          f"{number(ee80, 3)} px.")
