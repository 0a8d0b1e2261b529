"""Point spread function from a pupil: the wavefront error of a lens over its field, diffraction, charge diffusion and pixel.

The transfer function of the pupil (its autocorrelation) is multiplied by those of the pixel's square, of the charge's
diffusion and of a pinhole's disc; the image at a pixel is its Fourier sum. Being band limited it needs no interpolation, and it
has no function in common with those that a PSF map is fitted with.

Centre convention as in `psf`: a source's position is the centre of mass of its light. The wavefront has no slope in the pupil's
middle, so that coma throws the light outward of the chief ray by 2 lambda N times the mean slope, exact for a uniform pupil.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import fft2, fftfreq, ifft2, next_fast_len
from scipy.special import j1

PERIOD_PX = 40.0  # the Fourier sum repeats after so many pixels: the far wings of the next copy are below 1e-5 of the peak


@dataclass(frozen=True, kw_only=True)
class Pupil:
    """A lens by its wavefront error, Zernike polynomials in waves rms (Noll's normalisation), field 1 at the image corner.

    lambda_n_px: wavelength times f-number in pixels, the unit of diffraction. defocus_waves: everywhere; curvature_waves:
    defocus at the corner, with the square of the field; astigmatism_waves: so too, along the radius; coma_waves: at the
    corner, linear in the field, outward where positive. spherical_waves and trefoil_waves (one of its rays along +x, as of a
    strained element): everywhere. diffusion_sigma_px: of charge in the sensor. centre_px: optical axis.
    """

    lambda_n_px: float
    centre_px: tuple[float, float]
    corner_radius_px: float
    defocus_waves: float = 0.0
    curvature_waves: float = 0.0
    astigmatism_waves: float = 0.0
    coma_waves: float = 0.0
    spherical_waves: float = 0.0
    trefoil_waves: float = 0.0
    diffusion_sigma_px: float = 0.0


def coma_shift_px(pupil: Pupil, field: np.ndarray | float) -> np.ndarray | float:
    """How far (N,) outward of the chief ray the light's centre of mass lies, at field radii (N,)."""
    return 2 * pupil.lambda_n_px * 3 * np.sqrt(8) * pupil.coma_waves * field


def stamps(pupil: Pupil, field: np.ndarray, outward: np.ndarray, dx: np.ndarray, dy: np.ndarray, *,
           pinhole_px: float = 0.0) -> np.ndarray:
    """Share of the light (N, R, C) in each pixel, for sources at field radii (N,) in outward directions (N, 2).

    dx (N, C), dy (N, R): pixel centres less the centre of mass. pinhole_px: diameter of the source's own image.
    """
    out = np.empty((len(field), dy.shape[1], dx.shape[1]))
    for i, (radius, direction) in enumerate(zip(field, outward, strict=True)):
        frequency, transfer = _transfer(pupil, radius, direction, pinhole_px)
        from_ray = coma_shift_px(pupil, radius) * direction
        along_x = np.exp(-2j * np.pi * frequency * (dx[i] + from_ray[0])[:, None])
        along_y = np.exp(-2j * np.pi * frequency * (dy[i] + from_ray[1])[:, None])
        out[i] = (along_y @ transfer @ along_x.T).real / PERIOD_PX**2
    return out


def _transfer(pupil: Pupil, field: float, outward: np.ndarray, pinhole_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (F,) in cycles a pixel and the transfer function (F, F) there, [row, column], 1 at frequency 0."""
    step = 2 * pupil.lambda_n_px / PERIOD_PX  # in pupil radii, so that the autocorrelation's shifts are the wanted frequencies
    half = int(np.ceil(1 / step))
    axis = step * np.arange(-half, half + 1)
    x, y = np.meshgrid(axis, axis)
    rho2 = x**2 + y**2
    radial = x * outward[0] + y * outward[1]
    waves = ((pupil.defocus_waves + pupil.curvature_waves * field**2) * np.sqrt(3) * (2 * rho2 - 1)
             + pupil.astigmatism_waves * field**2 * np.sqrt(6) * (2 * radial**2 - rho2)
             + pupil.coma_waves * field * np.sqrt(8) * 3 * rho2 * radial
             + pupil.spherical_waves * np.sqrt(5) * (6 * rho2 * (rho2 - 1) + 1)
             + pupil.trefoil_waves * np.sqrt(8) * x * (x**2 - 3 * y**2))
    size = 2 * next_fast_len(2 * half + 1)  # twice the pupil: the autocorrelation does not wrap around
    inside = rho2 <= 1
    amplitude = np.zeros(rho2.shape, complex)
    amplitude[inside] = np.exp(2j * np.pi * waves[inside])
    power = np.abs(fft2(amplitude, (size, size))) ** 2
    correlation = ifft2(power)
    frequency = fftfreq(size, 1 / size) / PERIOD_PX
    along = np.sinc(frequency) * np.exp(-2 * (np.pi * pupil.diffusion_sigma_px * frequency) ** 2)
    rest = np.outer(along, along)
    if pinhole_px > 0:
        across = np.maximum(np.pi * pinhole_px * np.hypot(frequency, frequency[:, None]), 1e-9)
        rest = rest * 2 * j1(across) / across
    return frequency, correlation / correlation[0, 0].real * rest
