"""What the PSF layer earns in the attitude, over coma: the same sky frames solved with and without it.

The thesis's camera with more or less coma and astigmatism; the PSF from 4 frames of 150 pinholes, lens and gain true, no other
layer measured, so that nothing but the PSF differs. The gain is a difference over the same frames, and so is its error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibench.calmap.assemble import without_layer
from calibench.geometry.sphere import camera_pointing_at, unit_from_radec
from calibench.measure import psf
from calibench.records import CalibrationMap, Frame, Observer
from calibench.session.sky import Sky
from calibench.simulate.camera import SimulatedCamera, stream, thesis_camera
from calibench.simulate.pinholes import pinholes
from calibench.simulate.sensor import Defects, expose
from calibench.simulate.starfield import SkyConditions, star_field
from calibench.simulate.truth import sky_truth
from calibench.validate.case import SkyCase, SkyTruth, cross_error_rad
from calibench.validate.trials import ablation

NO_DEFECTS = Defects(hot=0, hot_scale_e_per_s=1.0, warm=0, cold=0, dead=0, stuck=0, telegraph=0)
FRAMES, ARCSEC = 30, 180 * 3600 / np.pi


def taken(camera: SimulatedCamera, light_e: np.ndarray, exposure_s: float, rng: np.random.Generator) -> Frame:
    data = expose(camera, light_e, exposure_s=exposure_s, temperature_c=25.0, rng=rng)
    return Frame(data=data, kind="light", bit_depth=10, white_level_dn=camera.sensor.white_level_dn, exposure_s=exposure_s,
                 gain_setting=camera.gain_setting, temperature_c=25.0, camera=camera.name)


def sky_case(camera: SimulatedCamera, sky: Sky, seed: int) -> SkyCase:
    rng = stream(9, seed)
    r_cam_icrs = camera_pointing_at(rng.uniform(0, 2 * np.pi), np.arcsin(rng.uniform(-1, 1)), rng.uniform(0, 2 * np.pi))
    field = star_field(camera, sky.table, r_cam_icrs, exposure_s=0.2, conditions=SkyConditions(), observer=Observer(), rng=rng)
    truth = sky_truth(camera, sky.table, field, r_cam_icrs, Observer())
    centre = unit_from_radec(*np.radians([truth["ra_deg"], truth["dec_deg"]]))
    return SkyCase(frame=taken(camera, field.light_e, 0.2, rng),
                   truth=SkyTruth(centre_icrs=centre, roll_rad=float(np.radians(truth["roll_deg"]))))


@pytest.mark.parametrize(("coma_px", "radial_px", "tangential_px"), [(0.2, 0.55, 0.25), (0.4, 0.8, 0.4), (0.7, 1.0, 0.5)])
def test_psf_layer_over_coma(coma_px, radial_px, tangential_px):
    camera = thesis_camera(1)
    camera = replace(camera, sensor=replace(camera.sensor, defects=NO_DEFECTS), aberrations=replace(
        camera.aberrations, coma_px=coma_px, radial_blur_px=radial_px, tangential_blur_px=tangential_px))
    calmap = CalibrationMap(image_size_px=camera.image_size_px, intrinsics=camera.intrinsics,
                            gain_dn_per_e=camera.sensor.gain_dn_per_e, measured=frozenset({"intrinsics", "gain_dn_per_e"}))
    spots = [taken(camera, pinholes(camera, columns=15, rows=10, flux_e=8000.0, rng=stream(1, i)).light_e, 0.02, stream(2, i))
             for i in range(4)]
    measured = psf.measure(spots, None, calmap)
    calmap = replace(calmap, psf=measured.psf, measured=calmap.measured | {"psf"})
    sky = Sky()
    cases, errors = [sky_case(camera, sky, i) for i in range(FRAMES)], {}
    for name, one in (("with", calmap), ("without", without_layer(calmap, "psf"))):
        tried = ablation.attempt(name, cases, one, lambda case: sky.finder(None), {}, lambda: None)
        errors[name] = np.array([cross_error_rad(s, c.truth) * ARCSEC if s.status == "solved" else np.nan
                                 for s, c in zip(tried.solutions, cases, strict=True)])
    solved = np.isfinite(errors["with"]) & np.isfinite(errors["without"])
    with_, without = (np.sqrt(np.mean(errors[name][solved] ** 2)) for name in ("with", "without"))
    difference = errors["without"][solved] ** 2 - errors["with"][solved] ** 2
    error = difference.std() / np.sqrt(solved.sum()) / (with_ + without)
    print(f"\ncoma {coma_px} px at the corner, {solved.sum()} of {FRAMES} frames: {without:.2f} arcsec without the PSF, "
          f"{with_:.2f} with it, earned {without - with_:.2f} +- {error:.2f}; magnitude term "
          f"{1e3 * measured.quantity('magnitude_term_px').value:.0f} mpx")
