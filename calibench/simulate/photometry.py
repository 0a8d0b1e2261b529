"""How many photo-electrons a star or the sky gives the simulated camera."""

from __future__ import annotations

import numpy as np

from .camera import SimulatedCamera

# Vega outside the atmosphere: f_lambda(5500 A) = 3.6e-9 erg/s/cm^2/A (Bessell 1979) over h c / lambda = 3.61e-12 erg makes
# 1000 photons/s/cm^2/A, so 1e6 in 100 nm. An A0 star's photon rate is flat to some 20 % from 450 to 800 nm, and the sensor's
# sensitivity is taken as its mean quantum efficiency over that band of 350 nm.
PHOTONS_PER_S_CM2_NM_V0 = 1.0e4
BAND_NM = 350.0


def star_electrons_per_s(camera: SimulatedCamera, v_mag: np.ndarray) -> np.ndarray:
    """Photo-electrons per second of stars of V magnitude v_mag, on the axis.

    Flux times band times pupil area times lens throughput times quantum efficiency. For the thesis's lens and sensor
    (pupil 0.336 cm^2, throughput 0.8, quantum efficiency 0.4) that is 3.8e5 e-/s at V = 0 and 3.8e3 at V = 5. The star's
    colour, which would change this by up to some 0.5 mag, and the atmosphere are left out.
    """
    zero_point = (PHOTONS_PER_S_CM2_NM_V0 * BAND_NM * camera.lens.aperture_cm2 * camera.lens.throughput
                  * camera.sensor.quantum_efficiency)
    return zero_point * 10 ** (-0.4 * np.asarray(v_mag, float))


def sky_electrons_per_s(camera: SimulatedCamera, sky_mag_arcsec2: float) -> float:
    """Photo-electrons per second and pixel, on the axis, of a sky of this V brightness per square arcsecond."""
    pixel_arcsec = np.degrees(camera.pixel_size_um * 1e-3 / camera.lens.focal_mm) * 3600
    return float(star_electrons_per_s(camera, sky_mag_arcsec2) * pixel_arcsec**2)
