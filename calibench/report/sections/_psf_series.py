"""Figures that a PSF measurement has only where more is known: the focus series, and the stars that the camera detects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...records import Measurement, Quantity
from ...spots.psf import FWHM_PER_SIGMA
from ..draw import BLUE, FAINT, GREEN, GREY, HALF, ORANGE, RED, WIDE, png, sheet
from ..numbers import number
from ..section import Figure

STARS = (("matched", "a matched filter finds it", BLUE), ("four_pixels", "any four pixels lit", GREEN),
         ("plus", "the plus lit", ORANGE), ("ten_pixels", "a tenth pixel lit", RED))


def focus_figure(measurement: Measurement) -> Figure | None:
    """Size and centroid bound by focus position, and the focal surface from the centre outwards."""
    of = measurement.evidence
    if "focus_um" not in of:
        return None
    figures = _by_name(measurement)
    made, (curve, field) = sheet(WIDE, 2)
    curve.plot(of["focus_um"], FWHM_PER_SIGMA * np.sqrt(of["focus_moment_px2"]), "o-", color=BLUE)
    curve.set(xlabel="focus position (µm)", ylabel="FWHM, median over the field (px)", title="Through focus")
    curve.grid(color=FAINT)
    bound = curve.twinx()
    bound.plot(of["focus_um"], 1e3 * of["focus_centroid_bound_px"], "s--", color=ORANGE)
    bound.set_ylabel("least centroid error (mpx), dashed")
    bound.spines["right"].set_visible(True)
    best = figures["focus_best_um"]
    if best.value is not None:
        curve.axvline(best.value, color=GREY, linewidth=0.8)
    width, height = np.array(measurement.image_size_px) - 1
    x, y = (of["field_xy_px"] - (width / 2, height / 2)).T
    drawn = field.scatter(x, of["focus_surface_um"], c=y, cmap="cividis")
    made.colorbar(drawn, ax=field, pad=0.02).set_label("row from the centre (px)")
    field.set(xlabel="column from the centre (px)", ylabel="best focus (µm)", title="Focal surface")
    field.grid(color=FAINT)
    said = (f"Best focus {_with_error(best)} µm (grey line), for a centroid {_with_error(figures['focus_centroid_um'])} µm. It "
            f"differs by {_with_error(figures['focus_tilt_x_um'])} µm from left to right, "
            f"{_with_error(figures['focus_tilt_y_um'])} µm from top to bottom, by {_with_error(figures['focus_curvature_um'])} "
            "µm from the centre to the corners." if best.value is not None else f"No best focus: {best.reason}.")
    return Figure(title="Focus", png=png(made), wide=True, reading=said)


def stars_figure(measurement: Measurement) -> Figure | None:
    """Least star by each criterion from the centre of the field outwards."""
    of = measurement.evidence
    if "field_star_plus_e" not in of:
        return None
    figures = _by_name(measurement)
    made, (axes,) = sheet(HALF)
    size = np.array(measurement.image_size_px) - 1
    radius = np.hypot(*(of["field_xy_px"] - size / 2).T)
    order = np.argsort(radius)
    for name, label, colour in STARS:
        axes.plot(radius[order], of[f"field_star_{name}_e"][order], ".-", color=colour, label=label, linewidth=0.8)
    axes.set(xlabel="distance from the centre (px)", ylabel="flux of the star (e⁻)", yscale="log")
    axes.set_ylim(top=4 * of["field_star_ten_pixels_e"].max())  # room for the legend
    axes.grid(color=FAINT)
    axes.legend(ncols=2, loc="upper center")
    plus, ten, least = (figures[f"star_{name}_{'mag' if figures['star_plus_mag'].value is not None else 'e'}"]
                        for name in ("plus", "ten_pixels", "matched"))
    unit = {"mag": "mag", "e-": "e⁻"}[plus.unit]
    verdict = ("With a fixed threshold the thesis's star (the plus lit, at most nine pixels) is one"
               if figures["star_plus_e"].value < figures["star_ten_pixels_e"].value else
               "No star meets the thesis's criterion at most places in a pixel: the plus is lit")
    return Figure(title="The faintest stars over the field", png=png(made),
                  reading=f"{verdict} from {number(plus.value, 4)} to {number(ten.value, 4)} {unit}; a matched filter reaches "
                          f"{number(least.value, 4)} {unit}. Medians over the places in a pixel.")


def _by_name(measurement: Measurement) -> Mapping[str, Quantity]:
    return {quantity.name: quantity for quantity in measurement.quantities}


def _with_error(quantity: Quantity) -> str:
    if quantity.value is None:
        return "unknown"
    return number(quantity.value, 3) + (f" ± {number(quantity.uncertainty, 2)}" if quantity.uncertainty is not None else "")
