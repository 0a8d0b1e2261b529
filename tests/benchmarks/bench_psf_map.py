"""The PSF map against the truth of a lens rendered from its pupil: 49 places x 10 exposures, 4e4 e- a spot, 10 e- read noise.

photutils' EPSFBuilder is the peer (one ePSF for the whole field is all that it makes); skipped where it is not installed.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from calibench.measure._psf.epsf import Windows, fit_shape
from calibench.measure._psf.field import CORE_PER_SIGMA
from calibench.measure._psf.spot_shapes import LARGEST_RADIUS_PX, SMALLEST_RADIUS_PX
from calibench.simulate.pupil import Pupil, stamps
from calibench.spots import hermite
from calibench.spots.centroid import psf_map
from calibench.spots.centroid.kernels import fit_shapes
from calibench.spots.gaussian_fit import fit_gaussians

SIZE = (752, 480)
def lens(lambda_n_px=0.4, **aberrations):
    return Pupil(centre_px=(379.8, 236.6), corner_radius_px=446.0, lambda_n_px=lambda_n_px, **aberrations)


CASES = {  # the scale of the core was chosen on the first three, not on the others
    "nominal": lens(coma_waves=0.055, astigmatism_waves=0.13, curvature_waves=0.05, diffusion_sigma_px=0.42),
    "undersampled": lens(coma_waves=0.03, astigmatism_waves=0.06, curvature_waves=0.03, diffusion_sigma_px=0.31),
    "defocused": lens(coma_waves=0.08, astigmatism_waves=0.15, defocus_waves=0.44, curvature_waves=0.1, diffusion_sigma_px=0.8),
    "sharper": lens(0.3, coma_waves=0.02, astigmatism_waves=0.03, diffusion_sigma_px=0.28),
    "spherical": lens(coma_waves=0.06, astigmatism_waves=0.08, spherical_waves=0.12, diffusion_sigma_px=0.5),
    "trefoil": lens(0.55, coma_waves=0.04, astigmatism_waves=0.1, trefoil_waves=0.1, curvature_waves=0.1,
                    diffusion_sigma_px=0.45),
    "fast": lens(0.25, coma_waves=0.12, astigmatism_waves=0.25, curvature_waves=0.15, defocus_waves=0.2,
                 diffusion_sigma_px=0.5),
    "slow": lens(1.2, coma_waves=0.05, astigmatism_waves=0.06, diffusion_sigma_px=0.4),
    "wide": lens(coma_waves=0.05, astigmatism_waves=0.1, defocus_waves=0.5, spherical_waves=0.08, diffusion_sigma_px=1.0)}


def outward_of(lens, xy):
    offset = (xy - np.array(lens.centre_px)) / lens.corner_radius_px
    field = np.hypot(*offset.T)
    return field, offset / field[:, None]


def spots(lens, rng, radius=None):
    """490 spots and the sigma of their Gaussians; radius None: of the windows that `psf` would cut out."""
    if radius is None:
        sigma = spots(lens, np.random.default_rng(9), LARGEST_RADIUS_PX)[1]
        radius = int(np.clip(np.ceil(3 * sigma + 2), SMALLEST_RADIUS_PX, LARGEST_RADIUS_PX))
    x, y = np.meshgrid(np.linspace(14, SIZE[0] - 15, 7), np.linspace(14, SIZE[1] - 15, 7))
    xy = np.tile(np.stack([x.ravel(), y.ravel()], -1), (10, 1)) + rng.uniform(-0.5, 0.5, (490, 2))
    corner, side = np.rint(xy).astype(int) - radius, np.arange(2 * radius + 1)
    field, outward = outward_of(lens, xy)
    light = 4e4 * stamps(lens, field, outward, corner[:, :1] + side - xy[:, :1], corner[:, 1:] + side - xy[:, 1:])
    data = rng.poisson(light + 20) - 20 + rng.normal(0, 10, light.shape)
    start = xy + rng.normal(0, 0.03, xy.shape)
    given = Windows(data_dn=data, floor_dn2=np.full(data.shape, 120.0), good=np.ones(data.shape, bool), corner_xy=corner,
                    xy_px=start, flux_dn=data.sum((1, 2)), background_dn=np.zeros(490))
    stacked = [a.reshape(-1, len(side)) for a in (data, given.floor_dn2, ~given.good)]
    shift = np.column_stack([np.zeros(490), len(side) * np.arange(490)]) - corner
    fit = fit_gaussians(*stacked, start + shift, np.tile([0.5, 0.5, 0.0], (490, 1)), gain_dn_per_e=1.0, radius=radius,
                        free_shape=True)
    return given, float(np.sqrt(np.median(fit.moments_px2[fit.converged, :2])))


def core_rms(lens, shape):
    """Rms over 5 x 5 px of the difference to the truth at its best shift, flux and background, as a share of the peak."""
    share = np.linspace(0.06, 0.94, 5)
    xy = np.array([(a * (SIZE[0] - 1), b * (SIZE[1] - 1)) for a in share for b in share])
    field, outward = outward_of(lens, xy)
    fine, out = np.arange(-10, 11) / 5, []
    for i, place in enumerate(hermite.coefficients_at(shape, xy, SIZE)):
        truth = stamps(lens, field[i:i + 1], outward[i:i + 1], fine[None], fine[None])[0]
        shift = np.zeros(2)
        for _ in range(3):
            def image(dx, dy, shift=shift, place=place):
                return hermite.image(place, shape, fine - shift[0] + dx, fine - shift[1] + dy).ravel()
            slopes = [(image(-dx, -dy) - image(dx, dy)) / 2e-3 for dx, dy in ((1e-3, 0), (0, 1e-3))]
            design = np.stack([image(0, 0), *slopes, np.ones(441)], -1)
            found = np.linalg.lstsq(design, truth.ravel(), rcond=None)[0]
            shift = shift + found[1:3] / found[0]
        out.append(np.mean((truth.ravel() - design @ found) ** 2) / truth.max() ** 2)
    return 100 * np.sqrt(np.mean(out))


def sampled_core_rms(lens, epsf, oversampling):
    """`core_rms` of one ePSF for the whole field, pixel included, sampled `oversampling` times a pixel about its middle."""
    share = np.linspace(0.06, 0.94, 5)
    xy = np.array([(a * (SIZE[0] - 1), b * (SIZE[1] - 1)) for a in share for b in share])
    field, outward = outward_of(lens, xy)
    half, out = epsf.shape[0] // 2, []
    reach = 2 * oversampling
    fine = np.arange(-reach, reach + 1) / oversampling
    middle = epsf[half - reach:half + reach + 1, half - reach:half + reach + 1]
    by_y, by_x = np.gradient(middle)
    design = np.stack([middle.ravel(), by_x.ravel(), by_y.ravel(), np.ones(middle.size)], -1)
    for i in range(len(xy)):
        truth = stamps(lens, field[i:i + 1], outward[i:i + 1], fine[None], fine[None])[0].ravel()
        out.append(np.mean((truth - design @ np.linalg.lstsq(design, truth, rcond=None)[0]) ** 2) / truth.max() ** 2)
    return 100 * np.sqrt(np.mean(out))


def biases_mpx(lens, shape, rng, flux_e, noisy):
    """(position by place, error less its place's mean, normalised error squared, us a spot) of 40 places x 8 phases."""
    xy, phase = rng.uniform(20, np.array(SIZE) - 20, (40, 2)), rng.uniform(-0.5, 0.5, (40, 8, 2))
    field, outward = outward_of(lens, xy)
    half = psf_map.window_radius(shape) + 1
    offset = np.arange(-half, half + 1)
    light = np.concatenate([stamps(lens, np.full(8, field[i]), np.tile(outward[i], (8, 1)), offset - phase[i, :, :1],
                                   offset - phase[i, :, 1:]) for i in range(40)])
    repeat = 20 if noisy else 1
    light = flux_e * np.tile(light, (repeat, 1, 1))
    data = rng.poisson(light + 20) - 20 + rng.normal(0, 10, light.shape) if noisy else light
    which = np.tile(np.repeat(np.arange(40), 8), repeat)
    true = np.tile(phase.reshape(-1, 2), (repeat, 1))
    core, wings = psf_map.matrices(shape, hermite.coefficients_at(shape, xy[which], SIZE))
    image = data.astype(np.float32)
    clock = time.process_time()
    found = fit_shapes(image, np.full(image.shape, 120, np.float32), half + true, core, wings, shape.scale_px,
                       hermite.WING_FACTOR * shape.scale_px, 1.0, np.full(len(image), shape.core_residual), half - 1)
    clock = time.process_time() - clock
    error = found[:, :2] - half - true
    mean = np.array([np.nanmean(error[which == i], 0) for i in range(40)])
    rest = error - mean[which]
    covariance = found[:, [4, 6, 6, 5]].reshape(-1, 2, 2)
    squared = np.einsum("ni,nij,nj->n", rest, np.linalg.inv(covariance), rest) / 2 if noisy else np.zeros(1)
    return 1e3 * mean, 1e3 * rest, float(np.nanmean(squared)), 1e6 * clock / len(found)


@pytest.mark.parametrize("name", CASES)
def test_map_against_truth(name):
    lens = CASES[name]
    given, sigma = spots(lens, np.random.default_rng(0))
    clock = time.process_time()
    fitted = fit_shape(given, SIZE, gain_dn_per_e=1.0, scale_px=sigma * np.interp(sigma, *CORE_PER_SIGMA), pinhole_px=0.0,
                       dither_coverage=1.0)
    clock = time.process_time() - clock
    shape = fitted.shape
    (faint, _, _, _), (bright, phase, _, _) = (biases_mpx(lens, shape, np.random.default_rng(1), f, False) for f in (1e3, 1e5))
    honest = {flux: biases_mpx(lens, shape, np.random.default_rng(2), flux, True) for flux in (1e3, 1e4, 1e5)}
    print(f"\n{name} (sigma {sigma:.2f}): order {shape.order}, degree {shape.degree}, "
          f"core rms {core_rms(lens, shape):.3f} % of peak ({100 * shape.core_residual:.3f} % by itself), phase bias "
          f"{np.sqrt(np.mean(phase**2)):.2f} mpx, magnitude term {np.sqrt(np.mean((bright - faint) ** 2)):.2f} mpx rms "
          f"{np.abs(bright - faint).max():.2f} largest, {clock:.2f} CPU s, {shape.coefficients.nbytes / 1e3:.1f} kB; "
          + ", ".join(f"{f:.0e} e-: error squared {h[2]:.3f}, {h[3]:.1f} us" for f, h in honest.items()))


def test_photutils_on_the_same_spots():
    psf = pytest.importorskip("photutils.psf", reason="photutils is not installed here: pip install photutils in a venv")
    lens = CASES["nominal"]
    given, _ = spots(lens, np.random.default_rng(0))
    cut = [psf.EPSFStar(d, cutout_center=at - corner) for d, at, corner in
           zip(given.data_dn, given.xy_px, given.corner_xy, strict=True)]
    clock = time.process_time()
    epsf = psf.EPSFBuilder(oversampling=4, maxiters=10, progress_bar=False)(psf.EPSFStars(cut))
    clock = time.process_time() - clock
    data = np.asarray(epsf.data if hasattr(epsf, "data") else epsf[0].data)
    print(f"\nphotutils EPSFBuilder, one ePSF for the field: {clock:.1f} CPU s, core rms "
          f"{sampled_core_rms(lens, data, 4):.2f} % of peak")
