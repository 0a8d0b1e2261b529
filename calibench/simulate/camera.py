"""SimulatedCamera: a camera of which everything is known, and the camera of the thesis that calibench follows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.projection import unproject
from ..records import Intrinsics
from .lens import Lens, transmission
from .psf import Aberrations
from .pupil import Pupil
from .sensor import Defects, FixedPattern, Sensor, fixed_pattern


@dataclass(frozen=True, kw_only=True)
class SimulatedCamera:
    """The truth about a camera. `seed` settles its fixed pattern and its dust; scenes and noise have their own."""

    name: str
    intrinsics: Intrinsics
    pixel_size_um: float
    gain_setting: float
    sensor: Sensor
    lens: Lens
    aberrations: Aberrations | Pupil
    seed: int

    @property
    def image_size_px(self) -> tuple[int, int]:
        return self.intrinsics.image_size_px

    @cached_property
    def pattern(self) -> FixedPattern:
        return fixed_pattern(self.sensor, self.image_size_px, stream(self.seed, 0))

    @cached_property
    def rays(self) -> np.ndarray:
        """(H, W, 3) unit vectors of the pixel centres in camera axes."""
        width, height = self.image_size_px
        rows, cols = np.mgrid[:height, :width]
        xy_px = np.column_stack([cols.ravel(), rows.ravel()]).astype(float)
        return unproject(self.intrinsics, xy_px).reshape(height, width, 3)

    @cached_property
    def transmission(self) -> np.ndarray:
        """(H, W) relative light of an evenly bright scene: vignetting and dust."""
        return transmission(self.lens, self.rays, stream(self.seed, 1))


def stream(seed: int, *key: int) -> np.random.Generator:
    """An independent random stream for each key under one seed, so that one more frame leaves the others as they were."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def thesis_camera(seed: int = 1) -> SimulatedCamera:
    """The thesis's star camera: MT9V022, 752 x 480 pixels of 6 um, 10 bit, with an 8.5 mm f/1.3 lens; 29.7 x 19.2 deg.

    Distortion as the thesis measured it (k1 -0.3686, k2 0.3148), rounded, with a smaller decentring; the radial curve
    1 + 3 k1 r^2 + 5 k2 r^4 has no real root, so it folds nowhere. Number and scale of the hot pixels were fitted by us so that
    the thesis's rule (5 sigma above the mean of 20 averaged darks) counts about its 24, 149 and 318 at 24.3, 48.6 and 72.9 ms
    when the stuck pixels are left out; with them the rule's sigma grows several-fold and it counts fewer than ten. Noise, gain,
    response and the other defects are plausible choices for this sensor, not the thesis's measurements, and so are coma and
    astigmatism for so fast a lens: asymmetry 0.2 at the corner, where a Gaussian's centre wanders by 40 mpx with the flux.
    """
    width, height = 752, 480
    focal_px = 8.5e3 / 6.0
    centre_px = ((width - 1) / 2 + 4.3, (height - 1) / 2 - 2.9)
    return SimulatedCamera(
        name="MT9V022 (simulated)",
        intrinsics=Intrinsics(model="brown5", fx_px=focal_px, fy_px=focal_px, cx_px=centre_px[0], cy_px=centre_px[1],
                              distortion=np.array([-0.37, 0.31, -0.0011, 0.0003, 0.0]), image_size_px=(width, height),
                              covariance=np.zeros((9, 9))),
        pixel_size_um=6.0, gain_setting=4.0, seed=seed,
        sensor=Sensor(bit_depth=10, gain_dn_per_e=0.1, offset_dn=64.0, read_noise_e=9.0, reset_noise_e=4.0,
                      full_well_e=12000.0, quantum_efficiency=0.40, dark_rate_e_per_s=12.0, dark_rate_spread=0.2,
                      dark_reference_c=25.0, dark_doubling_c=7.0, dsnu_e=2.5, column_dn=0.12, prnu=0.010,
                      defects=Defects(hot=1200, hot_scale_e_per_s=165.0, warm=400, cold=60, dead=12, stuck=6,
                                      telegraph=10)),
        lens=Lens(focal_mm=8.5, f_number=1.3, throughput=0.80, barrel_from=0.75, barrel_at_corner=0.88, dust_shadows=9),
        aberrations=Aberrations(core_sigma_px=0.60, radial_blur_px=0.80, tangential_blur_px=0.40, coma_px=0.40,
                                centre_px=centre_px, corner_radius_px=float(np.hypot(width, height)) / 2))
