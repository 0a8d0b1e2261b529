"""The compiled step towards a centre of symmetry against a plain numpy form."""

from __future__ import annotations

import numpy as np

from calibench.measure.corners.kernels import odd_parts

SIGMA_PX = 0.8
REACH, MARGIN = 5, 4


def plain(patch, fraction, room_px, inverse, bend, half):
    """Weight, gradient, odd part and sums of one point, from sums of Gaussians over all pixels."""
    pixel, at = np.arange(-REACH - MARGIN, REACH + MARGIN + 1), np.arange(-REACH, REACH + 1)
    t = pixel - at[:, None] - fraction[:, None, None]
    gauss = np.where(abs(pixel - at[:, None]) <= MARGIN, np.exp(-0.5 * (t / SIGMA_PX) ** 2), 0)
    gauss /= gauss.sum(axis=-1, keepdims=True)
    slope = gauss * t / SIGMA_PX**2
    light = gauss[1] @ patch @ gauss[0].T
    gradient = np.stack([gauss[1] @ patch @ slope[0].T, slope[1] @ patch @ gauss[0].T])
    gradient = (gradient - gradient[:, ::-1, ::-1]) / 2
    u, v = np.tensordot(inverse, np.stack(np.meshgrid(at, at)), 1)
    shift = np.tensordot(bend, np.stack([u * u, u * v, v * v]), 1)
    odd = (light - light[::-1, ::-1]) / 2 + (gradient * shift).sum(axis=0)
    weight = np.prod([np.where(abs(x) < half, np.cos(np.pi / 2 * x / half) ** 2, 0) for x in (u, v)], axis=0)
    weight *= (abs(at) <= room_px[0]) & (abs(at) <= room_px[1])[:, None]
    gx, gy = gradient
    return weight, gradient, odd, [(weight * a * b).sum() for a, b in ((gx, gx), (gx, gy), (gy, gy), (gx, odd), (gy, odd))]


def test_matches_the_plain_form():
    rng = np.random.default_rng(0)
    points, n = 6, 2 * REACH + 1
    patch = rng.uniform(0, 200, (points, n + 2 * MARGIN, n + 2 * MARGIN)).astype(np.float32)
    fraction, room = rng.uniform(-0.5, 0.5, (points, 2)), rng.integers(2, 9, (points, 2))
    inverse = np.linalg.inv([[20.0, 4.0], [-3.0, 17.0]] + rng.normal(0, 1, (points, 2, 2)))
    bend, half = rng.normal(0, 5, (points, 2, 3)), rng.uniform(0.15, 0.3, points)
    weight, odd = np.full((2, points, n, n), np.nan, np.float32)
    gradient, sums = np.full((points, 2, n, n), np.nan, np.float32), np.empty((points, 5))
    odd_parts(patch, fraction, SIGMA_PX, room, inverse, bend, half, weight, gradient, odd, sums)
    for p in range(points):
        expected = plain(patch[p], fraction[p], room[p], inverse[p], bend[p], half[p])
        for found, right in zip((weight[p], gradient[p], odd[p], sums[p]), expected, strict=True):
            np.testing.assert_allclose(found, right, rtol=1e-4, atol=2e-4)
    assert (weight == 0).any() and (weight > 0.9).any()
