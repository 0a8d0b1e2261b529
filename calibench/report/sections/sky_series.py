"""Series: several sky frames together. Where the camera looked, what residual is common to them, and their errors by kind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from ...geometry import sphere
from ...stars.solve import Solution
from ...validate.series_errors import SeriesErrors, split
from ..draw import BLUE, FAINT, GREY, INK, ORANGE, png, sensor_axes, sensor_sheet, sheet
from ..numbers import ARCSEC, MISSING, number, plural, sentence
from ..section import Figure, Section, Table
from ..story import Story

ORDER = 65
TITLE = "Sky frames together"
FEWEST_FRAMES = 2
NUMBERED = 12  # of more frames only the first and the last are
STEPS_DEG = (0.5, 1, 2, 5, 10, 15, 30)  # of the lines of equal right ascension and declination
LONGEST_PX = 0.5  # of the mean arrows, in parts of a cell: how long they are drawn


def render(story: Story) -> Section | None:
    series = story.series or tuple(sky.calibrated for sky in story.sky)
    solved = [solution for solution in series if solution.status == "solved"]
    if len(solved) < FEWEST_FRAMES:
        return None
    errors = split(series)
    text = (f"{len(solved)} of {plural(len(series), 'frame')} solved. What the residuals of many frames have in common is no "
            "noise: a part that is smooth over the field is the lens's, a part that goes with the place within a pixel is the "
            "pixel's.")
    return Section(paragraphs=(text,), tables=(_kinds(errors),), figures=(_sky(solved), _residuals(errors, solved)))


def _kinds(errors: SeriesErrors) -> Table:
    columns = ("Kind", "One star (px)", "Cross-boresight (arcsec)", "Roll (arcsec)", "Why not")

    def cell(value: float | None, scale: float = 1.0) -> str:
        return MISSING if value is None else number(value * scale, 3)
    rows = tuple((kind.name, cell(kind.star_px), cell(kind.cross_rad, ARCSEC), cell(kind.roll_rad, ARCSEC), kind.reason)
                 for kind in errors.kinds)
    return Table(title="Errors by kind, 1σ (ECSS-E-ST-60-20C)", columns=columns, rows=rows, numbers=frozenset(columns[1:4]),
                 note=f"From {errors.stars} stars of {plural(errors.frames, 'frame')}. One star: of one axis. The other two: "
                      "what such errors of its stars do to the attitude of one frame.")


def _sky(solved: Sequence[Solution]) -> Figure:
    """Matched stars and the image's centre of every frame, equal-area about the middle of the series, north up, east left."""
    looks = sphere.unit_from_radec([s.ra_rad for s in solved], [s.dec_rad for s in solved])
    middle = looks.sum(0)
    middle = looks[0] if np.linalg.norm(middle) < 1e-3 * len(looks) else middle / np.linalg.norm(middle)
    north, east = sphere.north_and_east(middle)

    def flat(v: np.ndarray) -> np.ndarray:
        grown = np.sqrt(2 / np.maximum(1 + v @ middle, 1e-9))
        return np.degrees(np.stack([-grown * (v @ east), grown * (v @ north)]))
    stars, track = flat(np.concatenate([s.identification.direction_icrs for s in solved])), flat(looks)
    half = 1.08 * max(np.abs(stars).max(), np.abs(track).max())
    made, (axes,) = sheet((5.6, 5.6))
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal", xlabel="degrees from the middle (east is left)",
             ylabel="degrees from the middle (north is up)")
    _graticule(axes, flat, middle, half)
    axes.plot(*stars, ".", color=BLUE, markersize=3, label=f"matched stars ({stars.shape[1]})")
    for n in range(1, len(solved)):
        if sphere.angle_between(looks[n - 1], looks[n]) < solved[n].fov_rad:  # a track; a longer way is a new target
            axes.plot(*track[:, n - 1:n + 1], "-", color=ORANGE, linewidth=1)
    axes.plot(*track, "+", color=ORANGE, markersize=8, label=f"image centres ({len(solved)})")
    for n in range(len(solved)) if len(solved) <= NUMBERED else (0, len(solved) - 1):
        axes.annotate(str(n + 1), track[:, n], xytext=(5, 4), textcoords="offset points", color=INK)
    axes.legend(loc="upper left", bbox_to_anchor=(0, -0.09), ncols=2, handletextpad=0.2)
    ra, dec = sphere.radec_from_unit(middle)
    farthest = np.degrees(sphere.angle_between(looks, middle).max())
    return Figure(title="Where the camera looked", png=png(made), reading=sentence(
        f"{plural(stars.shape[1], 'matched star')} in {plural(len(solved), 'frame')}, centres within {number(farthest, 3)} "
        f"degrees of RA {np.degrees(ra):.2f}, Dec {np.degrees(dec):+.2f}"))


def _graticule(axes: Axes, flat: object, middle: np.ndarray, half_deg: float) -> None:
    """Lines of equal right ascension and declination, with their degrees where they cross the edge's inside."""
    step = next((s for s in STEPS_DEG if s >= half_deg / 3), STEPS_DEG[-1])
    ra, dec = (float(np.degrees(angle)) for angle in sphere.radec_from_unit(middle))
    along = np.linspace(0, 360, 721)
    lines = [(along, np.full(721, d), f"Dec {d:g}°") for d in np.arange(-90 + step, 90, step)]
    lines += [(np.full(721, r), along / 2 - 90, f"RA {r:g}°") for r in np.arange(0, 360, step)]
    for ras, decs, label in lines:
        x, y = flat(sphere.unit_from_radec(np.radians(ras), np.radians(decs)))
        inside = (np.abs(x) < half_deg) & (np.abs(y) < half_deg)
        if inside.any():
            axes.plot(np.where(inside, x, np.nan), np.where(inside, y, np.nan), color=FAINT, linewidth=0.6, zorder=0)
            off = (ras - ra + 180) % 360 - 180 if label[0] == "D" else decs - dec
            at = int(np.argmin(np.where(inside, np.abs(off), np.inf)))
            axes.text(x[at], y[at], label, color=GREY, fontsize=7, clip_on=True)


def _residuals(errors: SeriesErrors, solved: Sequence[Solution]) -> Figure:
    size = solved[0].identification.intrinsics.image_size_px
    made, (axes,) = sensor_sheet(size, bars=False)
    sensor_axes(axes, size)
    xy, mean = errors.map_xy_px, errors.map_residual_px
    length = np.hypot(*mean.T)
    apart_px = min(size[0] / 8, size[1] / 5)
    magnified = float(f"{LONGEST_PX * apart_px / max(np.quantile(length, 0.9), 1e-6):.1g}")
    axes.quiver(*xy.T, *mean.T, angles="xy", scale_units="xy", scale=1 / magnified, color=BLUE, width=0.004)
    for (x, y), stars in zip(xy, errors.map_stars, strict=True):
        axes.annotate(str(stars), (x, y), xytext=(0, -10), textcoords="offset points", ha="center", fontsize=6.5, color=GREY)
    rms = float(np.sqrt((mean**2).sum(1).mean()))
    return Figure(title=f"Mean residual over the field, ×{magnified:g}", png=png(made), reading=sentence(
        f"mean arrows {number(rms, 2)} px rms, longest {number(length.max(), 2)} px; small figures: stars of a cell"))
