"""Point spread function over the field, from frames of pinholes (or of sharp stars).

1. Spots on each frame; saturated, crowded, faint and defective ones are set aside and counted.
2. A Gaussian with free second moments is fitted to each; it is integrated over the pixels, so the moments are those of
   the light before the pixel (add 1/12 px^2 for the recorded spot).
3. The moments become polynomials over the field, spots that disagree left out.
Figures are field medians over the spots.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from ..calmap.correct import correct
from ..errors import BadInput
from ..records import CalibrationMap, Frame, Measurement, PsfMap, Quantity
from ..spots.psf import FWHM_PER_SIGMA, field_terms
from ._gain import known_gain
from ._ledger import Ledger
from ._spot_shapes import SpotShapes, axes_px, shapes

PIXEL_VARIANCE_PX2 = 1 / 12
CLIP_SIGMA = 4.0
SPOTS_PER_TERM = 3
DEGREES = (4, 3, 2, 1, 0)
ANNULUS_PX = 0.2
GROUPS = 8


@dataclass(frozen=True, kw_only=True)
class Settings:
    """k_sigma: detection threshold. least_snr: peak over noise of a spot whose shape is used. least_spots: of all frames."""

    k_sigma: float = 5.0
    least_snr: float = 20.0
    least_spots: int = 10


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
        found.append(shapes(corrected, frame.image_size_px, k_sigma=settings.k_sigma, least_snr=settings.least_snr))
    size = ledger.first.image_size_px
    gain = known_gain(calmap, ledger.first)
    _check(found, settings)
    xy, moments = (np.concatenate([getattr(s, name) for s in found]) for name in ("xy_px", "moments_px2"))
    psf, residual, used = _map(xy, moments, size)
    ee_radius, ee = encircled(found)
    flux = np.concatenate([s.flux_dn for s in found])
    unit = gain.dn_per_e if np.isfinite(gain.dn_per_e) else 1.0
    return Measurement(
        name="psf", image_size_px=size, psf=psf,
        quantities=_quantities(moments[used], found, psf),
        evidence={"spot_xy_px": xy, "spot_moments_px2": moments, "spot_residual_px2": residual, "spot_used": used,
                  "spot_frame": np.repeat(np.arange(len(found)), [len(s.xy_px) for s in found]),
                  "spot_flux_e" if np.isfinite(gain.dn_per_e) else "spot_flux_dn": flux / unit,
                  "encircled_radius_px": ee_radius, "encircled_fraction": ee},
        provenance=ledger.provenance(), warnings=_warnings(ledger, warnings, xy[used], size, calmap),
        frames_used=len(found), frames_rejected=tuple(ledger.rejected))


def _check(found: list[SpotShapes], settings: Settings) -> None:
    usable = sum(len(s.xy_px) for s in found)
    reasons: dict[str, int] = {}
    for each in found:
        for reason, count in each.rejected.items():
            reasons[reason] = reasons.get(reason, 0) + count
    if reasons.get("saturated", 0) > usable:
        raise BadInput(f"{reasons['saturated']} spots are saturated, {usable} are not", mend="shorten the exposure: the "
                       "brightest pixel of a spot should reach 50 to 80 % of the range")
    if usable < settings.least_spots:
        listed = ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count) or "none"
        raise BadInput(f"{usable} usable spots, {settings.least_spots} are the least (set aside: {listed})",
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


def _ee80_px(found: list[SpotShapes]) -> float:
    radius, share = encircled(found)
    return float(np.interp(0.8, np.maximum.accumulate(share), radius))


def _quantities(moments: np.ndarray, found: list[SpotShapes], psf: PsfMap) -> tuple[Quantity, ...]:
    major, minor = axes_px(moments)
    recorded = moments + np.array([PIXEL_VARIANCE_PX2, PIXEL_VARIANCE_PX2, 0])
    central = np.prod(erf(0.5 / np.sqrt(2 * moments[:, :2])), axis=1)
    groups = [[_rows(s, slice(i, None, GROUPS)) for s in found] for i in range(GROUPS)]
    radii = [_ee80_px(g) for g in groups if sum(len(s.xy_px) for s in g) >= 3]
    without_pixel = "median over the field; Gaussian moments, pixel integration taken out"
    return (
        _median("fwhm_px", FWHM_PER_SIGMA * np.sqrt(major * minor), "px", without_pixel),
        _median("fwhm_with_pixel_px", FWHM_PER_SIGMA * np.sqrt(np.multiply(*axes_px(recorded))), "px",
                "median over the field; Gaussian moments as the sensor records them (1/12 px^2 more)"),
        _median("ellipticity", 1 - minor / major, "1", "1 - b/a; " + without_pixel),
        Quantity(name="ee80_radius_px", value=_ee80_px(found), unit="px", symbol="EE80",
                 uncertainty=float(np.std(radii, ddof=1) / np.sqrt(len(radii))) if len(radii) > 1 else None,
                 source="radius of 80 % of the light, mean of all spots, pixel included",
                 reason="" if len(radii) > 1 else "too few spots for an uncertainty"),
        _median("central_pixel_fraction", central, "1", "share of the light in the pixel that the spot is centred on"),
        Quantity(name="strehl", value=None, unit="1", source="peak over that of the diffraction-limited PSF",
                 reason="needs the f-number, the wavelength and the pinhole's size"),
        Quantity(name="spots_used", value=float(len(moments)), unit="1", source="count"),
        Quantity(name="psf_residual_px2", value=psf.residual_rms_px2, unit="px^2", source="rms of the moments about the map"))


def _rows(found: SpotShapes, rows: slice) -> SpotShapes:
    arrays = {name: getattr(found, name)[rows] for name in ("xy_px", "moments_px2", "flux_dn", "distance_px", "light")}
    return SpotShapes(**arrays, rejected={})


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
