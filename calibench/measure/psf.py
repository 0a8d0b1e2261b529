"""Point spread function over the field, from frames of pinholes (or of sharp stars).

1. Spots on each frame; saturated, crowded, faint and defective ones are set aside and counted.
2. A Gaussian with free second moments is fitted to each; it is integrated over the pixels, so the moments are those of
   the light before the pixel (add 1/12 px^2 for the recorded spot).
3. The moments become polynomials over the field, spots that disagree left out: the Gaussian member of the map.
4. Where the spots are enough and centred at all parts of a pixel, the shape itself is fitted (`_epsf`). It goes into the map if
   it predicts spots that were left out better than the Gaussian describes those it was fitted to; else the warnings say why.
Figures are field medians.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..calmap.correct import correct
from ..errors import BadInput
from ..records import CENTRE_OF_MASS, CalibrationMap, Frame, Measurement, PsfMap, Quantity
from ..spots.gaussian_fit import fit_gaussians
from ..spots.psf import FWHM_PER_SIGMA, field_terms, moments_at
from ._frames.ledger import Ledger
from ._gain import known_gain
from ._psf.epsf import Fitted, Windows, fit_shape
from ._psf.figures import FIGURES, LEAST_LAMBDA_N_PX, figures, strehl
from ._psf.spot_shapes import SpotShapes, axes_px, shapes

PIXEL_VARIANCE_PX2 = 1 / 12
CLIP_SIGMA = 4.0
SPOTS_PER_TERM = 3
DEGREES = (4, 3, 2, 1, 0)
ANNULUS_PX = 0.2
GROUPS = 8
PHASES = 4
CORE_PER_SIGMA = (0.6, 1.5), (1.1, 0.8)  # series' scale over the Gaussian's, by its sigma in px: found on rendered lenses


@dataclass(frozen=True, kw_only=True)
class Settings:
    """k_sigma: detection threshold. least_snr: peak over noise of a spot whose shape is used. least_spots: of all frames.

    shape_spots, dither: the least number of spots and share of the pixel (4 x 4 parts) in which they are centred, for a shape
    beyond a Gaussian. pinhole_px: diameter of the source's image, taken out of the shape. wavelength_um, f_number: for Strehl.
    """

    k_sigma: float = 5.0
    least_snr: float = 20.0
    least_spots: int = 10
    shape_spots: int = 60
    dither: float = 0.8
    pinhole_px: float = 0.0
    wavelength_um: float | None = None
    f_number: float | None = None


def measure(frames: Iterable[Frame], settings: Settings | None = None, calmap: CalibrationMap | None = None) -> Measurement:
    """PSF map and its figures.

    Args:
        frames: point sources on a dark background. calmap: applied first; without it the offset is taken off locally, but
            hot pixels and response stay.

    Raises:
        BadInput: no frames, mixed settings, too few usable spots (with the reasons), or most of them saturated.
    """
    settings = settings or Settings()
    ledger = Ledger(settings, "pinhole frames")
    found, warnings = [], []
    for frame in frames:
        if frame.kind in ("dark", "flat"):
            ledger.reject(frame, f"it says that it is a {frame.kind} frame")
            continue
        if not ledger.take(frame):
            continue
        applied = calmap or CalibrationMap(image_size_px=frame.image_size_px)
        corrected = correct(frame, applied)
        warnings += corrected.warnings
        found.append(shapes(corrected, frame.image_size_px, k_sigma=settings.k_sigma, least_snr=settings.least_snr,
                            radius_px=found[0].windows.data_dn.shape[1] // 2 if found else None))
    size = ledger.first.image_size_px
    gain = known_gain(calmap, ledger.first)
    _check(found, settings)
    xy, moments = (np.concatenate([getattr(s, name) for s in found]) for name in ("xy_px", "moments_px2"))
    psf, residual, used = _map(xy, moments, size)
    psf, fitted, why_not = _with_shape(psf, [s.windows for s in found], used, gain.dn_per_e, settings)
    if why_not:
        warnings.append(f"the PSF map holds a Gaussian only: {why_not}")
    aside = _set_aside(found) | {"with moments unlike the others": int((~used).sum())}
    if fitted is not None:
        aside["of a shape unlike the others (blend, ghost, drifting source)"] = int((~fitted.used).sum())
    if any(aside.values()):
        warnings.append(f"spots set aside: {_listed({reason: n for reason, n in aside.items() if n})}")
    ee_radius, ee = encircled(found)
    flux = np.concatenate([s.flux_dn for s in found])
    unit = gain.dn_per_e if np.isfinite(gain.dn_per_e) else 1.0
    return Measurement(
        name="psf", image_size_px=size, psf=psf,
        quantities=(*_quantities(moments[used], found, psf), *_shape_quantities(psf, fitted, found, ledger.first, settings)),
        evidence={"spot_xy_px": xy, "spot_moments_px2": moments, "spot_residual_px2": residual, "spot_used": used,
                  "spot_frame": np.repeat(np.arange(len(found)), [len(s.xy_px) for s in found]),
                  "spot_flux_e" if np.isfinite(gain.dn_per_e) else "spot_flux_dn": flux / unit,
                  "encircled_radius_px": ee_radius, "encircled_fraction": ee} | _shape_evidence(fitted),
        provenance=ledger.provenance(), warnings=_warnings(ledger, warnings, xy[used], size, calmap),
        frames_used=len(found), frames_rejected=tuple(ledger.rejected))


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


def _map(xy: np.ndarray, moments: np.ndarray, size: tuple[int, int]) -> tuple[PsfMap, np.ndarray, np.ndarray]:
    """PsfMap, residual (N, 3) of every spot and which spots were used."""
    used = np.ones(len(xy), bool)
    for _ in range(8):
        degree = next(d for d in DEGREES if d == 0 or SPOTS_PER_TERM * (d + 1) * (d + 2) // 2 <= used.sum())
        terms = field_terms(xy, size, degree)
        coefficients = np.linalg.lstsq(terms[used], moments[used], rcond=None)[0]
        residual = moments - terms @ coefficients
        sigma = 1.4826 * np.median(np.abs(residual[used]), axis=0)
        now = (np.abs(residual) <= CLIP_SIGMA * sigma + 1e-9).all(axis=1)
        if (now == used).all() or now.sum() < 0.7 * len(xy):
            break
        used = now
    psf = PsfMap(model="gaussian", degree=degree, coefficients=coefficients.T, image_size_px=size,
                 centre="centre of the Gaussian fitted by least squares, integrated over the pixels",
                 measured_xy_px=xy[used], residual_rms_px2=float(np.sqrt(np.mean(residual[used] ** 2))))
    return psf, residual, used


def dither_coverage(xy_px: np.ndarray) -> float:
    """Share of the 4 x 4 parts of a pixel in which some spot (N, 2) is centred."""
    part = np.floor(PHASES * ((xy_px + 0.5) % 1)).astype(int).clip(0, PHASES - 1)
    return len(np.unique(part[:, 0] * PHASES + part[:, 1])) / PHASES**2


def _with_shape(psf: PsfMap, cut_out: list[Windows], used: np.ndarray, gain: float,
                settings: Settings) -> tuple[PsfMap, Fitted | None, str]:
    """The map with its shape, and how it was fitted; or the map as it is, None, and why."""
    joined = {name: np.concatenate([getattr(w, name) for w in cut_out]) for name in Windows.__dataclass_fields__}
    spots = Windows(**joined).take(used)
    coverage = dither_coverage(spots.xy_px)
    if len(spots.xy_px) < settings.shape_spots:
        return psf, None, f"{len(spots.xy_px)} spots, a shape needs {settings.shape_spots}"
    if coverage < settings.dither:
        return psf, None, (f"the spots are centred in {100 * coverage:.0f} % of the pixel's parts, a shape needs "
                           f"{100 * settings.dither:.0f} %: move the source by fractions of a pixel")
    gain = gain if np.isfinite(gain) else 0.0
    moments = moments_at(psf, spots.xy_px)
    sigma = float(np.sqrt(np.median(moments[:, :2])))
    scale = sigma * float(np.interp(sigma, *CORE_PER_SIGMA))
    fitted = fit_shape(spots, psf.image_size_px, gain_dn_per_e=gain, scale_px=scale, pinhole_px=settings.pinhole_px,
                       dither_coverage=coverage)
    if fitted.used.sum() < settings.shape_spots:
        return psf, None, f"only {fitted.used.sum()} of {len(fitted.used)} spots agree on a shape"
    gaussian, held_out = _gaussian_chi2(spots.take(fitted.used), moments[fitted.used], gain), min(fitted.held_out.values())
    if gaussian <= held_out:
        return psf, None, (f"it describes the spots as well as a shape with more freedom predicts them (chi2 per pixel "
                           f"{gaussian:.3f}, {held_out:.3f})")
    return replace(psf, model="gauss_hermite", centre=CENTRE_OF_MASS, hermite=fitted.shape), fitted, ""


def _gaussian_chi2(spots: Windows, moments: np.ndarray, gain: float) -> float:
    """Chi2 per pixel of the Gaussian member, the windows set one below the other into one image."""
    count, side = spots.data_dn.shape[:2]
    radius = side // 2
    shift = np.column_stack([np.zeros(count), side * np.arange(count)]) - spots.corner_xy
    stacked = [a.reshape(count * side, side) for a in (spots.data_dn, spots.floor_dn2, ~spots.good)]
    fit = fit_gaussians(*stacked, spots.xy_px + shift, moments, gain_dn_per_e=gain, radius=radius)
    pixels = spots.good.sum((1, 2))
    return float((fit.chi2_per_dof * (pixels - 4))[fit.converged].sum() / pixels[fit.converged].sum())


def encircled(found: list[SpotShapes]) -> tuple[np.ndarray, np.ndarray]:
    """Radius (R,) px and the share of the light within it, pixel included, over all spots.

    A pixel's share of the flux is a sample of the recorded PSF at its distance; spots at all pixel phases together sample
    it finely. The mean in each annulus times its area adds up to the curve; the window holds all light by definition.
    """
    distance = np.concatenate([s.distance_px.ravel() for s in found])
    light = np.concatenate([s.light.ravel() for s in found])
    inside = np.isfinite(light) & (distance < min(s.distance_px.max() for s in found) / np.sqrt(2))
    edges = np.arange(0, distance[inside].max() + ANNULUS_PX, ANNULUS_PX)
    total, _ = np.histogram(distance[inside], edges, weights=light[inside])
    count, _ = np.histogram(distance[inside], edges)
    middle, sampled = (edges[1:] + edges[:-1]) / 2, count > 0
    density = np.interp(middle, middle[sampled], total[sampled] / count[sampled])
    curve = np.concatenate([[0], np.cumsum(density * np.pi * np.diff(edges**2))])
    return edges, curve / curve[-1]


def _radius_px(found: list[SpotShapes], share: float) -> float:
    radius, curve = encircled(found)
    return float(np.interp(share, np.maximum.accumulate(curve), radius))


def _encircled_radius(share: float, found: list[SpotShapes]) -> Quantity:
    groups = [[_rows(s, slice(i, None, GROUPS)) for s in found] for i in range(GROUPS)]
    radii = [_radius_px(g, share) for g in groups if sum(len(s.xy_px) for s in g) >= 3]
    percent = round(100 * share)
    return Quantity(name=f"ee{percent}_radius_px", value=_radius_px(found, share), unit="px", symbol=f"EE{percent}",
                    uncertainty=float(np.std(radii, ddof=1) / np.sqrt(len(radii))) if len(radii) > 1 else None,
                    source=f"radius of {percent} % of the light, mean of all spots, pixel included",
                    reason="" if len(radii) > 1 else "too few spots for an uncertainty")


def _quantities(moments: np.ndarray, found: list[SpotShapes], psf: PsfMap) -> tuple[Quantity, ...]:
    major, minor = axes_px(moments)
    recorded = moments + np.array([PIXEL_VARIANCE_PX2, PIXEL_VARIANCE_PX2, 0])
    without_pixel = "median over the field; Gaussian moments, pixel integration taken out"
    return (
        _median("fwhm_px", FWHM_PER_SIGMA * np.sqrt(major * minor), "px", without_pixel),
        _median("fwhm_with_pixel_px", FWHM_PER_SIGMA * np.sqrt(np.multiply(*axes_px(recorded))), "px",
                "median over the field; Gaussian moments as the sensor records them (1/12 px^2 more)"),
        _median("ellipticity", 1 - minor / major, "1", "1 - b/a; " + without_pixel),
        _encircled_radius(0.5, found), _encircled_radius(0.8, found),
        Quantity(name="spots_used", value=float(len(moments)), unit="1", source="count"),
        Quantity(name="psf_residual_px2", value=psf.residual_rms_px2, unit="px^2", source="rms of the moments about the map"))


def _shape_quantities(psf: PsfMap, fitted: Fitted | None, found: list[SpotShapes], first: Frame,
                      settings: Settings) -> tuple[Quantity, ...]:
    """Figures of the shape over the field; their errors by leaving out one part of the spots after the other."""
    radius = found[0].windows.data_dn.shape[1] // 2
    values = figures(psf, radius)
    if fitted is not None:
        others = [figures(replace(psf, hermite=one), radius) for one in fitted.without_fold]
        error = {name: float(np.sqrt((len(others) - 1) * np.var([o[name] for o in others]))) for name in values}
    reason = "" if fitted is not None else "of the Gaussian member; no error estimated"
    out = [Quantity(name=name, value=value, uncertainty=error[name] if fitted is not None else None, reason=reason,
                    unit="px" if name.endswith("_px") else "1", source=FIGURES[name]) for name, value in values.items()]
    out.append(_strehl(psf, first, settings))
    out.append(Quantity(name="chief_ray_shift_px", value=None, unit="px", source="centre of mass less chief ray",
                        reason="needs the chief rays' places, which spots alone do not tell"))
    shape = psf.hermite
    return (*out, Quantity(name="core_residual_percent", unit="%", value=100 * shape.core_residual if shape else None,
                           source="rms misfit above a fifth of the peak, of the peak",
                           reason="" if shape else "no shape in the map"))


def _strehl(psf: PsfMap, first: Frame, settings: Settings) -> Quantity:
    reason, value = "", None
    known = settings.wavelength_um and settings.f_number and first.pixel_size_um
    lambda_n_px = settings.wavelength_um * settings.f_number / first.pixel_size_um if known else 0.0
    if not known:
        reason = "needs wavelength_um, f_number and the pixel size"
    elif lambda_n_px < LEAST_LAMBDA_N_PX:
        reason = f"wavelength times f-number is {lambda_n_px:.2g} px: below {LEAST_LAMBDA_N_PX:g} the pixel hides the lens"
    else:
        value = strehl(psf, lambda_n_px)
    return Quantity(name="strehl", value=value, unit="1", reason=reason,
                    source="peak over that of the diffraction-limited PSF through the same pixel")


def _shape_evidence(fitted: Fitted | None) -> dict[str, np.ndarray]:
    if fitted is None:
        return {}
    return {"shape_spot_xy_px": fitted.spots.xy_px, "shape_spot_chi2": fitted.chi2, "shape_agrees": fitted.used,
            "held_out_order_degree": np.array(list(fitted.held_out)), "held_out_chi2": np.array(list(fitted.held_out.values()))}


def _rows(found: SpotShapes, rows: slice) -> SpotShapes:
    arrays = {name: getattr(found, name)[rows] for name in ("xy_px", "moments_px2", "flux_dn", "distance_px", "light")}
    return SpotShapes(**arrays, rejected={}, windows=found.windows)


def _median(name: str, values: np.ndarray, unit: str, source: str) -> Quantity:
    """Median with the 1-sigma error of a median, from the robust scatter."""
    scatter = 1.4826 * np.median(np.abs(values - np.median(values)))
    return Quantity(name=name, value=float(np.median(values)), uncertainty=float(1.2533 * scatter / np.sqrt(len(values))),
                    unit=unit, source=source)


def _warnings(ledger: Ledger, said: list[str], xy: np.ndarray, size: tuple[int, int],
              calmap: CalibrationMap | None) -> tuple[str, ...]:
    out = [*ledger.warnings, *dict.fromkeys(said)]
    if calmap is None:
        out.append("no map was applied: hot pixels and pixel response are still in the spots")
    covered = np.prod(np.ptp(xy, axis=0) / (np.array(size) - 1))
    if covered < 0.5:
        out.append(f"the spots cover {100 * covered:.0f} % of the image: beyond them the PSF map is a guess")
    return tuple(out)
