"""Sky: each sky frame with its stars named, solved without and with the map."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from ...geometry import projection, rotation
from ...stars.solve import Solution
from ...validate.case import SkyTruth, cross_error_rad, roll_error_rad
from ..draw import BLUE, GREY, INK, ORANGE, OUTLINED, png, sensor_axes, sensor_sheet
from ..numbers import ARCSEC, MISSING, fixed, number, plural, power_of_ten, sentence, sigma
from ..section import Badge, Figure, Section, Table
from ..story import SkyStory, Story

ORDER = 60
TITLE = "Night sky"
MAGNIFIED = 100
NAMED, UNMATCHED = 24, 12  # at most so many matched stars, and catalogue stars without a spot, get a name in the overlay
BRIGHT_MAGNITUDE = 5.0
LABEL_SIZE = (0.06, 0.015)  # width and height of a name, in widths of the image


def render(story: Story) -> Section | None:
    if not story.sky:
        return None
    figures = [figure for sky in story.sky for figure in (_overlay(sky, story), _residuals(sky)) if figure is not None]
    warnings = tuple(f"{sky.name}: {_failure(sky.calibrated)}" for sky in story.sky if sky.calibrated.status != "solved")
    summary = ("Each frame was solved lost in space, without the map and with it. Without it a lens is fitted to the frame's "
               "own stars, which takes residuals away but not the error of the attitude. Errors are against truth where it is "
               "known; σ are the solution's own random errors, across the boresight and in roll about it.")
    return Section(paragraphs=(summary,), warnings=warnings, tables=(_accuracy(story), _pointing(story)),
                   figures=tuple(figures))


def _accuracy(story: Story) -> Table:
    columns = ("Frame", "Map", "Status", "Matched", "Spots", "Residual (px)", "Residual (arcsec)", "Error (arcsec)",
               "Roll error (arcsec)", "Cross 1σ, 3σ (arcsec)", "Roll 1σ, 3σ (arcsec)", "False match")
    rows = tuple((sky.name, which, *_figures(solution, sky.truth)) for sky in story.sky
                 for which, solution in (("without", sky.raw), ("with", sky.calibrated)))
    return Table(title="Without and with the map", columns=columns, rows=rows, numbers=frozenset(columns[3:]),
                 note="Residual: rms of matched stars, sqrt(mean(dx² + dy²)). Error: angle between the solved and the true "
                      "direction of the image's centre. False match: probability that so good a match comes about by chance.")


def _figures(solution: Solution, truth: SkyTruth | None) -> tuple[str | Badge, ...]:
    """Everything in a row of the table after frame and map."""
    spots = str(len(solution.spots))
    if solution.status != "solved":
        return (Badge(status=solution.status), MISSING, spots, *[MISSING] * 7)
    cross, roll = solution.sigma_cross_rad * ARCSEC, solution.sigma_roll_rad * ARCSEC
    errors = [MISSING] * 2 if truth is None else [
        number(error(solution, truth) * ARCSEC, 3) for error in (cross_error_rad, roll_error_rad)]
    return (Badge(status="solved"), str(len(solution.attitude.residual_px)), spots, number(_rms_px(solution), 3),
            number(_rms_px(solution) * _arcsec_per_px(solution), 3), *errors, f"{sigma(cross)}, {sigma(cross, 3)}",
            f"{sigma(roll)}, {sigma(roll, 3)}", power_of_ten(solution.identification.false_match_probability))


def _pointing(story: Story) -> Table:
    columns = ("Frame", "RA (degrees)", "Dec (degrees)", "Roll (degrees)", "Field (degrees)",
               "Systematic cross 1σ, 3σ (arcsec)", "Systematic roll 1σ, 3σ (arcsec)", "Time (ms)")
    rows = tuple((sky.name, *_direction(sky.calibrated), number(1e3 * sum(sky.calibrated.timings_s.values()), 3))
                 for sky in story.sky)
    return Table(title="Where the image's centre looks (with the map)", columns=columns, rows=rows,
                 numbers=frozenset(columns[1:]),
                 note="ICRS axes; roll: position angle of the image's up direction, east of north; field: horizontal. "
                      "Systematic: what the lens's uncertainty adds, the same in all frames of one map.")


def _direction(solution: Solution) -> tuple[str, ...]:
    """Angles in degrees and the systematic uncertainties of centre and roll in arcsec."""
    angles = ((solution.ra_rad, 5), (solution.dec_rad, 5), (solution.roll_rad, 5), (solution.fov_rad, 3))
    systematic = (solution.systematic_centre_rad, np.sqrt(solution.systematic_covariance_rad2[2, 2]))
    return (*(fixed(np.degrees(angle), decimals) for angle, decimals in angles),
            *(f"{sigma(one * ARCSEC)}, {sigma(one * ARCSEC, 3)}" if np.isfinite(one) else MISSING for one in systematic))


def _rms_px(solution: Solution) -> float:
    return float(np.sqrt((solution.attitude.residual_px**2).sum(1).mean()))


def _arcsec_per_px(solution: Solution) -> float:
    return ARCSEC / solution.identification.intrinsics.fx_px


def _overlay(sky: SkyStory, story: Story) -> Figure:
    solution, found = sky.calibrated, sky.calibrated.identification
    h, w = sky.signal_dn.shape
    made, (axes,) = sensor_sheet((w, h), wide=True, bars=False)
    sensor_axes(axes, (w, h))
    axes.imshow(_stretched(sky.signal_dn), cmap="Greys", vmin=0, vmax=1, interpolation="antialiased")
    others = np.setdiff1d(np.arange(len(solution.spots)), found.spot_rows)
    ring = {"linestyle": "none", "markerfacecolor": "none", "markeredgewidth": 1.0}
    axes.plot(*solution.spots.xy_px[others].T, "s", color=ORANGE, markersize=6, label=f"other spots ({len(others)})", **ring)
    axes.plot(*found.xy_px.T, "o", color=BLUE, markersize=9, label=f"matched stars ({len(found.xy_px)})", **ring)
    said = [f"{plural(len(solution.spots), 'spot')}, {len(found.xy_px)} matched to stars"]
    if solution.status != "solved":
        said.append(_failure(solution))
    elif sky.catalogue is not None:
        said += _name_stars(axes, sky, story.star_names)
    axes.legend(loc="upper left", bbox_to_anchor=(0, -0.08), ncols=3, handletextpad=0.2)
    return Figure(title=f"{sky.name}: what the camera saw", png=png(made), reading=sentence(*said), wide=True)


def _failure(solution: Solution) -> str:
    return f"{solution.status.replace('_', ' ')}: {solution.attitude.reason}"


def _stretched(signal_dn: np.ndarray) -> np.ndarray:
    """(H, W) from 0 (sky) to 1 (brightest star), logarithmic far above the noise, so that faint and bright are seen."""
    level = np.median(signal_dn)
    noise = max(1.4826 * float(np.median(np.abs(signal_dn - level))), 1e-6)
    above = np.arcsinh(np.maximum(signal_dn - level - 2.5 * noise, 0) / (2 * noise))
    return above / max(float(above.max()), 1e-6)


def _name_stars(axes: Axes, sky: SkyStory, names: Mapping[int, str]) -> list[str]:
    """Names beside the brightest matched stars; bright catalogue stars that no spot was matched to are marked, and told."""
    found, catalogue = sky.calibrated.identification, sky.catalogue
    size_px = np.array(found.intrinsics.image_size_px)

    def name(row: int) -> str:
        hip = int(catalogue.table.hip[row])
        return names.get(hip, f"HIP {hip}")
    bright = np.argsort(catalogue.magnitude[found.star_rows], kind="stable")[:NAMED]
    labels = [(xy, name(row), BLUE) for xy, row in zip(found.xy_px[bright], found.star_rows[bright], strict=True)]
    matrix = rotation.matrix_from_quaternion(sky.calibrated.attitude.q_cam_icrs)
    xy_px = projection.project(found.intrinsics, catalogue.directions @ matrix.T)
    inside = ((xy_px > -0.5) & (xy_px < size_px - 0.5)).all(1) & (catalogue.magnitude < BRIGHT_MAGNITUDE)
    expected = np.flatnonzero(inside)  # in the order of the catalogue: brightest first
    missed = np.setdiff1d(expected, found.star_rows)
    axes.plot(*xy_px[missed].T, "x", color=GREY, markersize=6,
              label=f"catalogue, Hp < {BRIGHT_MAGNITUDE:g}, no spot ({len(missed)})")
    _label(axes, labels + [(xy_px[row], name(row), INK) for row in missed[:UNMATCHED]])
    first = found.star_rows[bright[0]]
    return [f"the brightest matched is {name(first)}, Hp {catalogue.magnitude[first]:.1f}",
            f"matched are {len(expected) - len(missed)} of the {len(expected)} catalogue stars in the field brighter than Hp "
            f"{BRIGHT_MAGNITUDE:g}"]


def _label(axes: Axes, labels: list[tuple[np.ndarray, str, str]]) -> None:
    """(place, text, colour) beside each star, towards the middle where the edge is near; none upon one before it."""
    width_px = axes.get_xlim()[1]
    taken = np.zeros((0, 2))
    for xy, text, colour in labels:
        if (np.abs(taken - xy) < np.array(LABEL_SIZE) * width_px).all(1).any():
            continue
        taken = np.vstack([taken, xy])
        left = xy[0] < 0.88 * width_px
        axes.annotate(text, xy, xytext=(6 if left else -6, 4), textcoords="offset points", ha="left" if left else "right",
                      fontsize=7.5, color=colour, path_effects=OUTLINED)


def _residuals(sky: SkyStory) -> Figure | None:
    """Arrows from each matched star, measured minus predicted; None where neither way solved the frame."""
    solved = [(name, s) for name, s in (("without the map", sky.raw), ("with the map", sky.calibrated)) if s.status == "solved"]
    if not solved:
        return None
    h, w = sky.signal_dn.shape
    made, panels = sensor_sheet((w, h), wide=True, columns=2, bars=False)
    said = []
    for axes, (name, solution) in zip(panels, solved, strict=False):
        sensor_axes(axes, (w, h), f"{name}: rms {number(_rms_px(solution), 3)} px")
        xy, residual = solution.identification.xy_px, solution.attitude.residual_px
        axes.quiver(*xy.T, *residual.T, angles="xy", scale_units="xy", scale=1 / MAGNIFIED, color=BLUE, width=0.0028)
        axes.plot(*xy.T, ".", color=INK, markersize=2.5)
        rms_px = _rms_px(solution)
        said.append(f"{name} {number(rms_px, 3)} px rms ({number(rms_px * _arcsec_per_px(solution), 3)} arcsec) over "
                    f"{plural(len(xy), 'star')}, longest {number(np.hypot(*residual.T).max(), 2)} px")
    for axes in panels[len(solved):]:
        axes.set_axis_off()
    return Figure(title=f"{sky.name}: residuals of the matched stars, ×{MAGNIFIED}", png=png(made), wide=True,
                  reading=sentence(*said))
