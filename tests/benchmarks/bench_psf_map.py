"""The PSF map against the truth of a lens rendered from its pupil: 49 places x 10 exposures, 4e4 e- a spot, 10 e- read noise.

The lenses of CASES were all looked at while the scale of the core was being chosen (a rule in sigma, `CORE_PER_SIGMA`): their
figures say how well the rule fits them. Those of DRAWN were not: Zernike coefficients, f-number and sigma come from a seed.

photutils' EPSFBuilder is the peer (one ePSF for the whole field is all that it makes), in a process of its own: CALIBENCH_PEERS
names a Python that has it; skipped where there is none.
"""

from __future__ import annotations

import os
import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest

from calibench.measure import psf
from calibench.measure._psf.epsf import Windows, fit_shape
from calibench.measure._psf.field import CORE_PER_SIGMA
from calibench.measure._psf.spot_shapes import LARGEST_RADIUS_PX, SMALLEST_RADIUS_PX
from calibench.records import Frame
from calibench.simulate.psf import render_sources
from calibench.simulate.pupil import Pupil, stamps
from calibench.spots import hermite
from calibench.spots.centroid import psf_map
from calibench.spots.centroid.kernels import fit_shapes
from calibench.spots.gaussian_fit import fit_gaussians

SIZE = (752, 480)


def lens(lambda_n_px=0.4, **aberrations):
    return Pupil(centre_px=(379.8, 236.6), corner_radius_px=446.0, lambda_n_px=lambda_n_px, **aberrations)


CASES = {
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
DRAWN = {f"drawn {seed}": seed for seed in (101, 102, 103, 104)}
DRAWN_RMS_WAVES = {"coma": 0.06, "astigmatism": 0.12, "curvature": 0.1, "defocus": 0.15, "spherical": 0.06, "trefoil": 0.05}
DRAWN_LAMBDA_N_PX, DRAWN_SIGMA_PX = (0.3, 0.8), (0.4, 1.5)
SHARPEST_DIFFUSION_PX = 0.2  # where the aberrations drawn are wider than the sigma drawn

PEER = """
import sys, time
import numpy as np
from astropy.table import Table
from photutils.psf import EPSFBuilder, EPSFStar, EPSFStars, ImagePSF, PSFPhotometry
given = np.load(sys.argv[1])
stars = EPSFStars([EPSFStar(d, cutout_center=c) for d, c in zip(given["data"], given["centre"])])
clock = time.process_time()
epsf = EPSFBuilder(oversampling=4, maxiters=10, progress_bar=False)(stars)[0]
clock = time.process_time() - clock
start = Table({"x": given["x"], "y": given["y"], "flux": np.full(len(given["x"]), given["flux"])})
fit = PSFPhotometry(ImagePSF(epsf.data, oversampling=4), fit_shape=int(given["side"]))
found = fit(given["tiled"], init_params=start)
np.savez(sys.argv[2], epsf=epsf.data, x=found["x_fit"], y=found["y_fit"], cpu_s=clock)
"""


def drawn(seed):
    rng = np.random.default_rng(seed)
    waves = {f"{name}_waves": rng.normal(0, rms) for name, rms in DRAWN_RMS_WAVES.items()}
    optics = lens(rng.uniform(*DRAWN_LAMBDA_N_PX), diffusion_sigma_px=SHARPEST_DIFFUSION_PX, **waves)
    sigma = rng.uniform(*DRAWN_SIGMA_PX)
    more = sigma**2 - spots(optics, np.random.default_rng(9), LARGEST_RADIUS_PX)[1] ** 2
    return replace(optics, diffusion_sigma_px=np.sqrt(SHARPEST_DIFFUSION_PX**2 + max(more, 0)))


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


def dithered(lens, rng, half):
    """Places (40, 2), phases (40, 8, 2) and the light (320, S, S) of a source there, about its pixel."""
    xy, phase = rng.uniform(20, np.array(SIZE) - 20, (40, 2)), rng.uniform(-0.5, 0.5, (40, 8, 2))
    field, outward = outward_of(lens, xy)
    offset = np.arange(-half, half + 1)
    return xy, phase, np.concatenate([stamps(lens, np.full(8, field[i]), np.tile(outward[i], (8, 1)), offset - phase[i, :, :1],
                                             offset - phase[i, :, 1:]) for i in range(40)])


def by_place(error, which):
    """Means (40, 2) of errors (N, 2) over the phases of each place, and what is left of the errors without them."""
    mean = np.array([np.nanmean(error[which == i], 0) for i in range(40)])
    return mean, error - mean[which]


def biases_mpx(lens, shape, rng, flux_e, noisy):
    """(position by place, error less its place's mean, normalised error squared, us a spot) of 40 places x 8 phases."""
    half = psf_map.window_radius(shape) + 1
    xy, phase, light = dithered(lens, rng, half)
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
    mean, rest = by_place(found[:, :2] - half - true, which)
    covariance = found[:, [4, 6, 6, 5]].reshape(-1, 2, 2)
    squared = np.einsum("ni,nij,nj->n", rest, np.linalg.inv(covariance), rest) / 2 if noisy else np.zeros(1)
    return 1e3 * mean, 1e3 * rest, float(np.nanmean(squared)), 1e6 * clock / len(found)


@pytest.mark.parametrize("name", [*CASES, *DRAWN])
def test_map_against_truth(name):
    lens = CASES[name] if name in CASES else drawn(DRAWN[name])
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


@pytest.mark.parametrize("name", ["nominal", "undersampled"])
def test_map_from_star_frames_against_truth(name):
    """`psf --from-stars` on 20 simulated frames of the sky, 60 stars of 3e3 to 1.5e5 e- on each, most of them faint."""
    lens, frames = CASES[name], []
    rng = np.random.default_rng(5)
    for _ in range(20):
        xy, flux = rng.uniform(2, np.array(SIZE) - 3, (60, 2)), 3e3 * 50 ** rng.random(60) ** 2
        image = rng.poisson(render_sources(lens, xy, flux, SIZE) + 30) + rng.normal(0, 10, SIZE[::-1])
        data = np.rint(100 + 0.25 * image).clip(0, 65535).astype(np.uint16)
        frames.append(Frame(data=data, kind="light", bit_depth=16, white_level_dn=65535, egain_e_per_dn=4.0))
    clock = time.process_time()
    measured = psf.measure(frames, psf.Settings(from_stars=True))
    clock = time.process_time() - clock
    shape = measured.psf.hermite
    if shape is None:
        print(f"\n{name}, from stars: no shape ({measured.warnings})")
        return
    _, phase, _, _ = biases_mpx(lens, shape, np.random.default_rng(1), 1e5, False)
    print(f"\n{name}, from {measured.quantity('spots_used').value:.0f} stars of 20 frames: order {shape.order}, degree "
          f"{shape.degree}, core rms {core_rms(lens, shape):.3f} % of peak ({100 * shape.core_residual:.3f} % by itself), "
          f"phase bias {np.sqrt(np.mean(phase**2)):.2f} mpx, {clock:.1f} CPU s")


def test_photutils_on_the_same_spots(tmp_path):
    """Its phase bias, too, with its own fit of its own ePSF, on noise-free spots set into one image."""
    python = os.environ.get("CALIBENCH_PEERS")
    if python is None or subprocess.run([python, "-c", "import photutils"], check=False).returncode:
        pytest.skip("photutils is not installed (CALIBENCH_PEERS names a Python that has it)")
    lens, half, across = CASES["nominal"], 12, 20
    given, _ = spots(lens, np.random.default_rng(0))
    _, phase, light = dithered(lens, np.random.default_rng(1), half)
    side = 2 * half + 1
    tiled = 1e5 * light.reshape(-1, across, side, side).transpose(0, 2, 1, 3).reshape(-1, across * side)
    number = np.arange(len(light))
    true = side * np.stack([number % across, number // across], -1) + half + phase.reshape(-1, 2)
    np.savez(tmp_path / "given.npz", data=given.data_dn, centre=given.xy_px - given.corner_xy, tiled=tiled, x=true[:, 0],
             y=true[:, 1], flux=1e5, side=7)
    subprocess.run([python, "-W", "ignore", "-c", PEER, str(tmp_path / "given.npz"), str(tmp_path / "found.npz")], check=True)
    found = np.load(tmp_path / "found.npz")
    _, rest = by_place(np.stack([found["x"], found["y"]], -1) - true, np.repeat(np.arange(40), 8))
    print(f"\nphotutils EPSFBuilder, one ePSF for the field: {found['cpu_s']:.1f} CPU s, core rms "
          f"{sampled_core_rms(lens, found['epsf'], 4):.2f} % of peak, phase bias {1e3 * np.sqrt(np.mean(rest**2)):.2f} mpx")
