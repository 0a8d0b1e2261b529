"""The figures of a PSF measurement as quantities with errors: from the spots themselves, and from the map over the field."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...records import Frame, PsfMap, Quantity
from ...spots.psf import FWHM_PER_SIGMA
from .field import FieldPsf
from .figures import FIGURES, LEAST_LAMBDA_N_PX, figures, strehl
from .spot_shapes import axes_px

PIXEL_VARIANCE_PX2 = 1 / 12
SIGNIFICANT = 3.0  # an angle belongs to an ellipticity of as many sigma


def spot_quantities(field: FieldPsf) -> list[Quantity]:
    """Medians of the used spots' own Gaussians."""
    moments = field.moments_px2[field.used]
    major, minor = axes_px(moments)
    recorded = moments + np.array([PIXEL_VARIANCE_PX2, PIXEL_VARIANCE_PX2, 0])
    without_pixel = "median over the field; Gaussian moments, pixel integration taken out"
    return [
        median("fwhm_px", FWHM_PER_SIGMA * np.sqrt(major * minor), "px", without_pixel),
        median("fwhm_with_pixel_px", FWHM_PER_SIGMA * np.sqrt(np.multiply(*axes_px(recorded))), "px",
               "median over the field; Gaussian moments as the sensor records them (1/12 px^2 more)"),
        median("ellipticity", 1 - minor / major, "1", "1 - b/a; " + without_pixel),
        Quantity(name="spots_used", value=float(len(moments)), unit="1", source="count"),
        Quantity(name="psf_residual_px2", value=field.psf.residual_rms_px2, unit="px^2",
                 source="rms of the moments about the map")]


def map_quantities(field: FieldPsf, radius_px: int) -> list[Quantity]:
    """Figures of the map over the field; their errors by leaving out one part of the spots after the other."""
    values = figures(field.psf, radius_px)
    others = [figures(one, radius_px) for one in field.without_part]
    error = {name: jackknife([other[name] for other in others]) for name in values}
    out = [Quantity(name=name, value=values[name], uncertainty=error[name], unit="px" if name.endswith("_px") else "1",
                    source=source) for name, source in FIGURES.items()]
    return [*out, _common_angle(values, [(other["e1"], other["e2"]) for other in others])]


def jackknife(without_part: Sequence[float]) -> float:
    """1-sigma error of a figure from its values without one part each."""
    return float(np.sqrt((len(without_part) - 1) * np.var(without_part)))


def _common_angle(values: dict[str, float], others: list[tuple[float, float]]) -> Quantity:
    """Direction of the common ellipticity; its error is half that of the vector across itself, over its length."""
    e = np.array([values["e1"], values["e2"]])
    length = float(np.hypot(*e))
    along, across = (np.array(others) @ axis for axis in (e / length, np.array([-e[1], e[0]]) / length))
    significant = length > SIGNIFICANT * max(jackknife(along), jackknife(across))
    return Quantity(
        name="ellipticity_angle_deg", unit="deg", value=float(np.degrees(np.arctan2(e[1], e[0]) / 2)) if significant else None,
        uncertainty=float(np.degrees(jackknife(across) / length / 2)) if significant else None,
        source="major axis of the common (e1, e2), from +x (right) towards +y (down)",
        reason="" if significant else f"no common direction: the common ellipticity is below {SIGNIFICANT:g} sigma")


def strehl_quantity(psf: PsfMap, first: Frame, wavelength_um: float | None, f_number: float | None) -> Quantity:
    """Strehl ratio where the diffraction is known and the sampling shows it."""
    reason, value = "", None
    known = wavelength_um and f_number and first.pixel_size_um
    lambda_n_px = wavelength_um * f_number / first.pixel_size_um if known else 0.0
    if not known:
        reason = "needs wavelength_um, f_number and the pixel size"
    elif lambda_n_px < LEAST_LAMBDA_N_PX:
        reason = f"wavelength times f-number is {lambda_n_px:.2g} px: below {LEAST_LAMBDA_N_PX:g} the pixel hides the lens"
    else:
        value = strehl(psf, lambda_n_px)
    return Quantity(name="strehl", value=value, unit="1", reason=reason,
                    source="peak over that of the diffraction-limited PSF through the same pixel")


def core_quantity(psf: PsfMap) -> Quantity:
    """Misfit of the shape in the map."""
    shape = psf.hermite
    return Quantity(name="core_residual_percent", unit="%", value=100 * shape.core_residual if shape else None,
                    source="rms misfit above a fifth of the peak, of the peak", reason="" if shape else "no shape in the map")


def median(name: str, values: np.ndarray, unit: str, source: str) -> Quantity:
    """Median with the 1-sigma error of a median, from the robust scatter."""
    scatter = 1.4826 * np.median(np.abs(values - np.median(values)))
    return Quantity(name=name, value=float(np.median(values)), uncertainty=float(1.2533 * scatter / np.sqrt(len(values))),
                    unit=unit, source=source)
