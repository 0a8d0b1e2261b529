"""Dust in the response: found by place, width and depth; pixels, scratches and the lamp are no dust."""

from __future__ import annotations

import numpy as np

from calibench.measure._flat.dust import find_dust

SHAPE = (240, 320)
PLACES = ((60.0, 50.0, 5.0, 0.03), (200.0, 120.0, 8.0, 0.015), (100.0, 190.0, 4.0, 0.08))  # x, y, sigma, depth


def response(rng):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    out = 1 + 0.01 * rng.standard_normal(SHAPE)
    for x0, y0, sigma, depth in PLACES:
        out *= 1 - depth * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * sigma**2))
    return out


def test_shadows_are_found_with_place_width_and_depth():
    found = find_dust(response(np.random.default_rng(1)), np.zeros(SHAPE, bool))
    assert len(found.depth) == 3 and list(found.depth) == sorted(found.depth, reverse=True)
    for x, y, sigma, depth in PLACES:
        i = int(np.argmin(np.hypot(*(found.xy_px - (x, y)).T)))
        assert np.hypot(*(found.xy_px[i] - (x, y))) < 0.4 * sigma
        assert 0.7 * depth < found.depth[i] < 1.3 * depth and sigma < found.diameter_px[i] < 6 * sigma


def test_pixels_lines_and_slow_shading_are_no_dust():
    rng = np.random.default_rng(2)
    flat = 1 + 0.01 * rng.standard_normal(SHAPE)
    flat[100, 100], flat[:, 200] = 0.3, 0.9
    flat *= 1 + 0.01 * np.cos(np.linspace(0, 6, SHAPE[1]))
    dead = flat < 0.5
    assert len(find_dust(flat, dead).depth) == 0
