"""Point spread function over the field, from frames of pinholes (or of sharp stars).

1. Spots on each frame; saturated, crowded, faint and defective ones are set aside and counted.
2. A Gaussian with free second moments is fitted to each; it is integrated over the pixels, so the moments are those of
   the light before the pixel (add 1/12 px^2 for the recorded spot).
3. The moments become polynomials over the field, spots that disagree left out: the Gaussian member of the map.
4. Where the spots are enough and centred at all parts of a pixel, the shape itself is fitted (`_psf/epsf`). It goes into the
   map if it predicts spots that were left out better than the Gaussian describes those it was fitted to; else warnings say why.
5. Figures: medians over the field, and which stars the camera detects with this PSF and the map's noise.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..calmap.correct import correct
from ..errors import BadInput
from ..records import CalibrationMap, Frame, Measurement, Quantity
from ._frames.ledger import Ledger
from ._gain import known_gain
from ._psf.chief_rays import chief_ray_shifts, shift_quantity
from ._psf.colours import MAIN, colour_pixels, lateral_colour, of_colour
from ._psf.encircled import encircled, encircled_radii
from ._psf.epsf import Fitted
from ._psf.faintest import ROUGH_PHASES, exposure_of, least_stars, star_quantities
from ._psf.field import FieldPsf, dither_coverage, over_field
from ._psf.figures import figures_at, places
from ._psf.focus import FEWEST_POSITIONS, Series, focus_quantities, series_of
from ._psf.quantities import core_quantity, map_quantities, spot_quantities, strehl_quantity
from ._psf.spot_shapes import SpotShapes, shapes
from ._psf.star_spots import moving

FEWEST_SPOTS = 12  # of a focus position
DRAWN_OUT = 0.1  # common ellipticity, where it has a direction, that a focused lens and a source at rest do not show


@dataclass(frozen=True, kw_only=True)
class Settings:
    """k_sigma: detection threshold. least_snr: peak over noise of a spot whose shape is used. least_spots: of all frames.

    shape_spots, dither: the least number of spots and share of the pixel (4 x 4 parts) in which they are centred, for a shape
    beyond a Gaussian. pinhole_px: diameter of the source's image, taken out of the shape. wavelength_um, f_number: for Strehl.
    star_exposure_s, sky_e_per_px_s, zero_point_mag: exposure (None: the frames'), sky and the magnitude of one e-/s, for the
    faintest stars. from_stars: the frames are of the sky: what stays on its pixel is no star, and stars that do not sample
    the pixel are refused.
    """

    k_sigma: float = 5.0
    least_snr: float = 20.0
    least_spots: int = 10
    shape_spots: int = 60
    dither: float = 0.8
    pinhole_px: float = 0.0
    wavelength_um: float | None = None
    f_number: float | None = None
    star_exposure_s: float | None = None
    sky_e_per_px_s: float = 0.0
    zero_point_mag: float | None = None
    from_stars: bool = False


def measure(frames: Iterable[Frame], settings: Settings | None = None, calmap: CalibrationMap | None = None) -> Measurement:
    """PSF map and its figures.

    Args:
        frames: point sources on a dark background. calmap: applied first; without it the offset is taken off locally, but
            hot pixels and response stay.

    Raises:
        BadInput: no frames, mixed settings, too few usable spots (with the reasons), or most of them saturated; focus positions
            that are no series.
    """
    settings = settings or Settings()
    ledger = Ledger(settings, "star frames" if settings.from_stars else "pinhole frames")
    by_colour, rays, focus, warnings = {}, [], [], []
    for frame in frames:
        if frame.kind in ("dark", "flat"):
            ledger.reject(frame, f"it says that it is a {frame.kind} frame")
            continue
        if not ledger.take(frame):
            continue
        applied = calmap or CalibrationMap(image_size_px=frame.image_size_px)
        corrected = correct(frame, applied)
        warnings += corrected.warnings
        for colour, counted in colour_pixels(frame.data.shape, frame.bayer_pattern).items():
            found = by_colour.setdefault(colour, [])
            alike = found[focus.index(frame.focus_um)] if frame.focus_um in focus else None
            found.append(shapes(corrected, frame.image_size_px, k_sigma=settings.k_sigma, least_snr=settings.least_snr,
                                radius_px=alike.windows.data_dn.shape[1] // 2 if alike else None, counted=counted))
        rays.append(frame.chief_rays_px)
        focus.append(frame.focus_um)
    first = ledger.first
    gain = known_gain(calmap, first)
    if settings.from_stars:
        by_colour = {colour: moving(found) for colour, found in by_colour.items()}
    found = next(iter(by_colour.values()), [])
    through, curves = [], {}
    if len(set(focus)) > 1:
        series = _series(found, focus, first.image_size_px)
        through, curves = focus_quantities(series)
        best = series.focus_um[np.argmin(series.sizes_px2)]
        warnings.append(f"a series of {len(series.focus_um)} focus positions: the PSF map is that at {best:g} um")
        here = [i for i, z in enumerate(focus) if z == best]
        by_colour = {colour: [all_of[i] for i in here] for colour, all_of in by_colour.items()}
        found, rays = next(iter(by_colour.values())), [rays[i] for i in here]
    _check(found, settings)
    field = over_field(found, first.image_size_px, gain_dn_per_e=gain.dn_per_e, shape_spots=settings.shape_spots,
                       dither=settings.dither, pinhole_px=settings.pinhole_px)
    warnings += _of_spots(found, field)
    radius = found[0].windows.data_dn.shape[1] // 2
    number = _numbers(found)
    shift = chief_ray_shifts(*_centres(field, number), rays)
    colours, lateral = [], {}
    for colour in [name for name in by_colour if name not in ("", MAIN)]:
        more, apart, said = _of_colour(colour, by_colour[colour], _centres(field, number), gain.dn_per_e, settings,
                                       first.image_size_px)
        colours, lateral, warnings = colours + more, lateral | apart, warnings + said
    if MAIN in by_colour:
        warnings.append("a colour mosaic: the PSF map, and figures without a colour's suffix, are those of the green pixels")
    curve = encircled(found)
    exposure = exposure_of(calmap, gain, first, exposure_s=settings.star_exposure_s, sky_e_per_px_s=settings.sky_e_per_px_s)
    stars = least_stars(field.psf, radius)
    quantities = (*spot_quantities(field), *encircled_radii(found, curve, (0.5, 0.8)), *map_quantities(field, radius),
                  strehl_quantity(field.psf, first, settings.wavelength_um, settings.f_number),
                  shift_quantity(shift, field.psf.centre), core_quantity(field.psf),
                  *star_quantities(exposure, stars, [least_stars(one, radius, ROUGH_PHASES) for one in field.without_part],
                                   settings.k_sigma, settings.zero_point_mag), *through, *colours)
    flux = np.concatenate([s.flux_dn for s in found])
    known = np.isfinite(gain.dn_per_e)
    return Measurement(
        name="psf", image_size_px=first.image_size_px, psf=field.psf, quantities=quantities,
        evidence={"spot_xy_px": field.xy_px, "spot_moments_px2": field.moments_px2, "spot_residual_px2": field.residual_px2,
                  "spot_used": field.used, "spot_frame": number,
                  "spot_flux_e" if known else "spot_flux_dn": flux / (gain.dn_per_e if known else 1.0),
                  "encircled_radius_px": curve[0], "encircled_fraction": curve[1]}
        | _shape_evidence(field.fitted) | _field_evidence(field, radius, stars, settings.k_sigma * exposure.noise_e, shift)
        | curves | lateral,
        provenance=ledger.provenance(), warnings=_warnings(ledger, [*warnings, *_drawn_out(quantities)], field, calmap),
        frames_used=len(found), frames_rejected=tuple(ledger.rejected))


def _numbers(found: list[SpotShapes]) -> np.ndarray:
    """(N,) number of each spot's frame."""
    return np.repeat(np.arange(len(found)), [len(s.xy_px) for s in found])


def _of_colour(colour: str, found: list[SpotShapes], green: tuple[np.ndarray, np.ndarray], gain_dn_per_e: float,
               settings: Settings, size: tuple[int, int]) -> tuple[list[Quantity], dict[str, np.ndarray], list[str]]:
    """Figures of a mosaic's other colour, its shift from green (places, frames), and what to say where spots are too few."""
    if sum(len(s.xy_px) for s in found) < settings.least_spots:
        return [], {}, [f"too few spots for the PSF of the {colour} pixels (set aside: {_listed(_set_aside(found))})"]
    field = over_field(found, size, gain_dn_per_e=gain_dn_per_e, shape_spots=settings.shape_spots, dither=settings.dither,
                       pinhole_px=settings.pinhole_px)
    quantity, evidence = lateral_colour(colour, *_centres(field, _numbers(found)), *green, size)
    figures = [*spot_quantities(field), *encircled_radii(found, encircled(found), (0.5, 0.8)),
               *map_quantities(field, found[0].windows.data_dn.shape[1] // 2), core_quantity(field.psf)]
    return [*of_colour(figures, colour), quantity], evidence, []


def _of_spots(found: list[SpotShapes], field: FieldPsf) -> list[str]:
    """Which spots were set aside, and why the map holds no shape."""
    out = [f"the PSF map holds a Gaussian only: {field.why_not}"] if field.why_not else []
    aside = _set_aside(found) | {"with moments unlike the others": int((~field.used).sum())}
    if field.fitted is not None:
        aside["of a shape unlike the others (blend, ghost, drifting source)"] = int((~field.fitted.used).sum())
    if any(aside.values()):
        out.append(f"spots set aside: {_listed({reason: n for reason, n in aside.items() if n})}")
    return out


def _series(found: list[SpotShapes], focus_um: list[float | None], image_size_px: tuple[int, int]) -> Series:
    """The through-focus series of these frames.

    Raises:
        BadInput: frames that do not say their position, or too few positions with spots.
    """
    if None in focus_um:
        raise BadInput(f"{focus_um.count(None)} frames do not say their focus position, others do",
                       mend="state focus_um in the sidecar of each frame, or give frames of one position")
    seen = {z for one, z in zip(found, focus_um, strict=True) if len(one.xy_px) >= FEWEST_SPOTS}
    if len(seen) < FEWEST_POSITIONS:
        raise BadInput(f"{len(set(focus_um))} focus positions, {len(seen)} of them with {FEWEST_SPOTS} usable spots: "
                       f"a through-focus series needs {FEWEST_POSITIONS}",
                       mend="give frames of one position, or of several on both sides of the best focus")
    chosen = [i for i, z in enumerate(focus_um) if z in seen]
    return series_of([found[i] for i in chosen], [focus_um[i] for i in chosen], image_size_px)


def _drawn_out(quantities: tuple[Quantity, ...]) -> list[str]:
    """A warning where all spots are drawn out alike."""
    of = {quantity.name: quantity.value for quantity in quantities}
    if of["ellipticity_angle_deg"] is None or of["ellipticity_common"] < DRAWN_OUT:
        return []
    return [f"all spots are drawn out in the same direction ({of['ellipticity_angle_deg']:.0f} degrees from +x towards +y, "
            f"1 - b/a {of['ellipticity_common']:.2f}): did the source or the camera move in the exposure?"]


def _set_aside(found: list[SpotShapes]) -> dict[str, int]:
    """Reason -> how many spots of all frames."""
    reasons = list(dict.fromkeys(reason for each in found for reason in each.rejected))
    counts = {reason: sum(each.rejected.get(reason, 0) for each in found) for reason in reasons}
    return {reason: count for reason, count in counts.items() if count}


def _listed(reasons: dict[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in reasons.items()) or "none"


def _check(found: list[SpotShapes], settings: Settings) -> None:
    usable, reasons = sum(len(s.xy_px) for s in found), _set_aside(found)
    if reasons.get("saturated", 0) > usable:
        raise BadInput(f"{reasons['saturated']} spots are saturated, {usable} are not", mend="shorten the exposure: the "
                       "brightest pixel of a spot should reach 50 to 80 % of the range")
    if usable < settings.least_spots:
        raise BadInput(f"{usable} usable spots, {settings.least_spots} are the least (set aside: {_listed(reasons)})",
                       mend="use more pinholes or frames, in focus, sharp and well apart")
    coverage = dither_coverage(np.concatenate([s.xy_px for s in found]))
    if settings.from_stars and coverage < settings.dither:
        raise BadInput(f"the stars are centred in {100 * coverage:.0f} % of the pixel's parts, {100 * settings.dither:.0f} % "
                       "are the least", mend="use more frames of other pointings, so that the stars fall on all its parts")


def _centres(field: FieldPsf, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 2) of the used spots and their frames (N,), as the map defines a spot's centre."""
    if field.fitted is None:
        return field.xy_px[field.used], number[field.used]
    return field.fitted.spots.xy_px, number[field.used][field.fitted.used]


def _shape_evidence(fitted: Fitted | None) -> dict[str, np.ndarray]:
    if fitted is None:
        return {}
    return {"shape_spot_xy_px": fitted.spots.xy_px, "shape_spot_chi2": fitted.chi2, "shape_agrees": fitted.used,
            "held_out_order_degree": np.array(list(fitted.held_out)), "held_out_chi2": np.array(list(fitted.held_out.values()))}


def _field_evidence(field: FieldPsf, radius_px: int, stars: dict[str, np.ndarray], threshold_e: float,
                    shift_px: np.ndarray) -> dict[str, np.ndarray]:
    """What plots over the field are drawn from."""
    at = places(field.psf.image_size_px)
    of = figures_at(field.psf, at, radius_px)
    out = {"field_xy_px": at, "field_fwhm_px": np.sqrt(of["fwhm_x_px"] * of["fwhm_y_px"])}
    out |= {f"field_{name}": of[name] for name in ("ellipticity", "angle_rad", "ee80_radius_px", "central_pixel_fraction")}
    if np.isfinite(threshold_e):
        out |= {f"field_star_{name}_e": threshold_e * np.median(values, axis=1) for name, values in stars.items()
                if name != "saturated"}
    return out | ({"chief_ray_shift_px": shift_px} if np.isfinite(shift_px).any() else {})


def _warnings(ledger: Ledger, said: list[str], field: FieldPsf, calmap: CalibrationMap | None) -> tuple[str, ...]:
    out = [*ledger.warnings, *dict.fromkeys(said)]
    if calmap is None:
        out.append("no map was applied: hot pixels and pixel response are still in the spots")
    covered = np.prod(np.ptp(field.xy_px[field.used], axis=0) / (np.array(field.psf.image_size_px) - 1))
    if covered < 0.5:
        out.append(f"the spots cover {100 * covered:.0f} % of the image: beyond them the PSF map is a guess")
    return tuple(out)
