"""The stars that this camera detects in one exposure: the thesis's criterion over the field, and the limiting magnitude.

Noise of a pixel without a star: read noise and the charge that dark current (and the sky, where it is stated) leave in the
exposure, all from the map that was applied. What is not known is named; no figure is made from a guess.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...calmap.correct import read_variance_dn2, saturation_of
from ...records import CalibrationMap, Frame, PsfMap, Quantity
from ...spots.detectable import CRITERIA, least_flux, limiting_magnitude
from .._gain import Gain
from .figures import pixel_shares, places
from .quantities import jackknife

PHASES, ROUGH_PHASES = 20, 8  # a side, over the pixel; the latter for the errors
WHAT = {
    "four_pixels": "any four pixels pass the threshold",
    "plus": "the brightest pixel and its four sides pass the threshold",
    "ten_pixels": "a tenth pixel passes the threshold: from here on a fixed one finds more than [T]'s nine",
    "saturated": "the brightest pixel saturates",
    "matched": "the matched filter passes the threshold: what any detector can reach",
}


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """One exposure of the sky: exposure_s, noise_e of a pixel without a star and its relative_uncertainty, saturation_e above
    the dark level. missing: what is not known of it; then noise_e is NaN."""

    exposure_s: float
    noise_e: float
    relative_uncertainty: float
    saturation_e: float
    missing: tuple[str, ...]


def exposure_of(calmap: CalibrationMap | None, gain: Gain, frame: Frame, *, exposure_s: float | None,
                sky_e_per_px_s: float) -> Exposure:
    """An exposure with this map; exposure_s None: the frame's own."""
    seconds = frame.exposure_s if exposure_s is None else exposure_s
    measured = calmap.measured if calmap is not None else frozenset()
    missing = [name for name, known in (
        ("gain", np.isfinite(gain.dn_per_e)), ("read noise", "read_noise_dn" in measured),
        ("dark rate", "dark_rate_dn_per_s" in measured), ("exposure", seconds is not None)) if not known]
    if missing:
        return Exposure(exposure_s=seconds or np.nan, noise_e=np.nan, relative_uncertainty=np.nan, saturation_e=np.nan,
                        missing=tuple(missing))
    read_e2 = float(np.median(read_variance_dn2(calmap))) / gain.dn_per_e**2
    dark_e = max(float(np.median(calmap.dark_rate_dn_per_s)), 0.0) / gain.dn_per_e * seconds
    level_dn = float(np.median(calmap.offset_dn)) + dark_e * gain.dn_per_e
    figure = calmap.quantities.get("dark.read_noise_e")
    read = figure.uncertainty / figure.value if figure and figure.uncertainty and figure.value else 0.0
    return Exposure(exposure_s=seconds, noise_e=float(np.sqrt(read_e2 + dark_e + sky_e_per_px_s * seconds)),
                    relative_uncertainty=float(np.hypot(read, gain.uncertainty / gain.dn_per_e)),
                    saturation_e=(saturation_of(frame, calmap) - level_dn) / gain.dn_per_e, missing=())


def least_stars(psf: PsfMap, radius_px: int, phases: int = PHASES) -> dict[str, np.ndarray]:
    """Criterion -> flux (places, phases) for a threshold of 1; `saturated`: for a full well of 1."""
    shares = [pixel_shares(psf, xy, radius_px, phases) for xy in places(psf.image_size_px)]
    out = {name: np.array([least_flux(one, 1.0, name) for one in shares]) for name in CRITERIA}
    return out | {"saturated": 1 / np.array([one.max((1, 2)) for one in shares])}


def star_quantities(exposure: Exposure, stars: dict[str, np.ndarray], others: Sequence[dict[str, np.ndarray]], k_sigma: float,
                    zero_point_mag: float | None) -> list[Quantity]:
    """Least star by each criterion, median over field and phases, in e- and as a magnitude.

    others: the same at ROUGH_PHASES without one part of the spots each, for the error. zero_point_mag: of one e- a second.
    """
    unknown = f"not known: {', '.join(exposure.missing)} (darks and flats make the map)" if exposure.missing else ""
    no_zero = unknown or ("" if zero_point_mag is not None else "needs zero_point_mag, the magnitude of one electron a second")
    out = [Quantity(name="pixel_noise_e", value=None if unknown else exposure.noise_e, unit="e-", reason=unknown,
                    uncertainty=None if unknown else exposure.noise_e * exposure.relative_uncertainty,
                    source=f"read noise and dark charge{_seconds(exposure)}, sky as stated")]
    for name, at in stars.items():
        level = exposure.saturation_e if name == "saturated" else k_sigma * exposure.noise_e
        unit_flux, spread = float(np.median(at)), [np.median(other[name]) for other in others]
        relative = float(np.hypot(jackknife(spread) / np.mean(spread),
                                  0.0 if name == "saturated" else exposure.relative_uncertainty))
        source = f"flux of a star of which {WHAT[name]}{_seconds(exposure)}; median over field and pixel phases"
        flux = None if unknown else level * unit_flux
        out.append(Quantity(name=f"star_{name}_e", value=flux, uncertainty=None if unknown else flux * relative, unit="e-",
                            source=source, reason=unknown))
        magnitude = None if no_zero else limiting_magnitude(flux, exposure.exposure_s, zero_point_mag)
        out.append(Quantity(name=f"star_{name}_mag", value=magnitude, unit="mag", source=source, reason=no_zero,
                            uncertainty=None if no_zero else 2.5 / float(np.log(10)) * relative))
    return out


def _seconds(exposure: Exposure) -> str:
    return f" in {exposure.exposure_s:g} s" if np.isfinite(exposure.exposure_s) else ""
