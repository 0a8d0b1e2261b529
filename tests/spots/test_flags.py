"""The compiled flags against plain numpy."""

import numpy as np
from scipy.special import erf

from calibench.records import DEFECT_FLAGS, SPOT_FLAGS
from calibench.spots.candidates import Candidates
from calibench.spots.flags import Near, flag
from calibench.spots.scene import Centroids

N, SIZE, GAIN = 400, (300, 200), 0.5


def test_flags_are_their_plain_form():
    rng = np.random.default_rng(1)
    peak = np.stack([rng.integers(0, SIZE[0], N), rng.integers(0, SIZE[1], N)], -1)
    nothing, ok = np.zeros(N), rng.random(N) < 0.9
    candidates = Candidates(xy_px=peak + rng.uniform(-0.5, 0.5, (N, 2)), peak_xy=peak, peak_dn=nothing, flux_dn=nothing,
                            pixels=nothing, elongation=rng.uniform(1, 4, N), blend=rng.random(N) < 0.1)
    found = Centroids(xy_px=candidates.xy_px, covariance_px2=np.zeros((N, 2, 2)), flux_dn=nothing, background_dn=nothing, ok=ok)
    signal = rng.exponential(50, (N, 3, 3)).astype(np.float32)
    signal[:, 1, 1] *= 10
    noise = rng.uniform(1, 5, N).astype(np.float32)
    saturated, broken = rng.random((2, N, 3, 3)) < 0.02
    moments = np.stack([rng.uniform(0.2, 1, N), rng.uniform(0.2, 1, N), np.zeros(N)], -1)
    defects = (saturated * DEFECT_FLAGS["saturated"] + broken * DEFECT_FLAGS["hot"]).astype(np.uint16)
    near = Near(signal_dn=signal, defects=defects, noise_dn=noise, background_dn=nothing)
    flags = flag(candidates, found, near, moments_px2=moments, image_size_px=SIZE, gain_dn_per_e=GAIN)

    apart = np.linalg.norm(candidates.xy_px[:, None] - candidates.xy_px, axis=-1) + 99 * np.eye(N)
    xy = peak[:, None, None] + np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), -1)
    beyond = ((xy < 0) | (xy >= np.array(SIZE))).any(-1)
    signal = np.where(beyond | broken, 0, signal)
    allowed = np.prod(erf(0.5 / np.sqrt(2 * moments[:, :2])) / erf(1.5 / np.sqrt(2 * moments[:, :2])), axis=1)
    light = signal.sum((1, 2))
    over = signal[:, 1, 1] / light - allowed
    sd = np.sqrt(noise**2 * (1 + 8 * allowed**2) + GAIN * signal[:, 1, 1] * (1 - allowed) ** 2) / light
    wanted = {"saturated": saturated.any((1, 2)), "defect": broken.any((1, 2)), "fit_failed": ~ok,
              "edge": (np.minimum(peak, np.array(SIZE) - 1 - peak) < 2).any(1),
              "blend": candidates.blend | (apart < 4).any(1), "trail": candidates.elongation > 3,
              "cosmic": (over > 5 * sd) & (signal[:, 1, 1] / light > 1.15 * allowed)}
    for name, on in wanted.items():
        assert 0 < on.sum() < N, name
        np.testing.assert_array_equal((flags & SPOT_FLAGS[name]) != 0, on, name)
    unknown = flag(candidates, found, near, moments_px2=None, image_size_px=SIZE, gain_dn_per_e=GAIN)
    np.testing.assert_array_equal(unknown, flags & ~np.uint16(SPOT_FLAGS["cosmic"]))
