"""Rendered frames in trouble, through the chain of `solve`: an attitude that is right, or a status with the right reason."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from calibench.geometry import projection
from calibench.records import CalibrationMap, Frame, Intrinsics, Observer
from calibench.session.sky import Sky
from calibench.stars.sky_catalogue import SkyCatalogue

SIZE, SHAPE = (752, 480), (480, 752)
SIGMA_PX, GAIN, OFFSET, WHITE = 0.9, 0.1, 64, 4095
FOV_DEG = 29.7
LENS = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=379.0, cy_px=236.0, distortion=[-0.37, 0.31, -1e-3, 3e-4],
                  image_size_px=SIZE, covariance=np.diag([.04, .04, .01, .01, 1e-8, 1e-8, 1e-12, 1e-12]))
MAP = CalibrationMap(image_size_px=SIZE, measured=frozenset({"offset_dn", "read_noise_dn", "gain_dn_per_e", "intrinsics"}),
                     offset_dn=np.full(SHAPE, OFFSET, np.float32), read_noise_dn=np.ones(SHAPE, np.float32),
                     gain_dn_per_e=GAIN, intrinsics=LENS)
NO_LENS = dataclasses.replace(MAP, intrinsics=None, measured=MAP.measured - {"intrinsics"})
WRONG_PX = dataclasses.replace(LENS, fx_px=LENS.fx_px * 5.2 / 6, fy_px=LENS.fy_px * 5.2 / 6)
ROW, COLUMN = np.mgrid[:SHAPE[0], :SHAPE[1]]


def points(xy, flux_dn) -> np.ndarray:
    """(H, W) DN of point sources (K, 2), each of 17 x 17 pixels."""
    light = np.zeros((SHAPE[0] + 32, SHAPE[1] + 32))
    at = np.arange(-8, 9)
    for (x, y), flux in zip(np.reshape(xy, (-1, 2)), np.broadcast_to(flux_dn, len(np.reshape(xy, (-1, 2)))), strict=True):
        i, j = round(x), round(y)
        if -8 <= i < SIZE[0] + 8 and -8 <= j < SIZE[1] + 8:
            along, down = (np.exp(-((n + at - c) / SIGMA_PX) ** 2 / 2) for n, c in ((i, x), (j, y)))
            light[np.ix_(j + at + 16, i + at + 16)] += flux / (2 * np.pi * SIGMA_PX**2) * np.outer(down, along)
    return light[16:-16, 16:-16]


def exposed(light_dn, rng) -> np.ndarray:
    data = rng.poisson(np.maximum(light_dn, 0) / GAIN + 50) * GAIN + OFFSET + rng.normal(0, 1, SHAPE)
    return np.clip(np.round(data), 0, WHITE)


def nothing(light, rng):
    return exposed(0 * light, rng)


def two_stars(light, rng):
    return exposed(points(rng.uniform(100, 400, (2, 2)), 3000), rng)


def hot_pixels(light, rng):
    data = exposed(light, rng)
    data[rng.integers(0, 480, 600), rng.integers(0, 752, 600)] += rng.exponential(400, 600)
    return data


def planets_and_a_satellite(light, rng):
    start, way = rng.uniform(100, 300, 2), rng.uniform(100, 250, 2)
    trail = start + np.linspace(0, 1, 300)[:, None] * way
    return exposed(light + points(rng.uniform(30, 450, (3, 2)), 40_000) + points(trail, 300), rng)


def clouds_on_half(light, rng):
    edge = 376 + 60 * gaussian_filter(rng.normal(size=SHAPE), 40) * 40
    cloud = 1 / (1 + np.exp((COLUMN - edge) / 30))
    return exposed(light * (1 - cloud) + cloud * (300 + 1500 * gaussian_filter(rng.normal(size=SHAPE), 12)), rng)


def trees(light, rng):
    top = 330 + np.cumsum(rng.normal(0, 3, 752)).clip(-60, 60)
    leaves = gaussian_filter(rng.random(SHAPE), 2) > 0.5
    behind = (top < ROW) & (leaves | (top + 60 < ROW))
    return exposed(np.where(behind, 15 * (rng.random(SHAPE) < 0.02), light + 60 * np.exp(-((480 - ROW) / 200) ** 2)), rng)


def a_moon(light, rng):
    away = np.hypot(COLUMN - rng.uniform(150, 600), ROW - rng.uniform(120, 360))
    return exposed(light + np.where(away < 25, 1e5, 0) + 3000 * np.exp(-away / 40) + 150 * np.exp(-away / 200), rng)


def saturated(light, rng):
    return np.full(SHAPE, float(WHITE))


def twilight(light, rng):
    return exposed(light + 6000 * (ROW / 480) ** 2, rng)


def shaken(light, rng):
    return exposed(light / 2 + np.roll(light, (3, 5), (0, 1)) / 2, rng)


def stamped(light, rng):
    """Date and time burnt into the image."""
    data = exposed(light, rng)
    for at in range(20, 300, 14):
        data[450:466, at:at + 8] = np.where(rng.random((4, 2)).repeat(4, 0).repeat(4, 1) < 0.5, WHITE, data[450:466, at:at + 8])
    return data


def as_it_is(light, rng):
    return exposed(light, rng)


class Trouble(NamedTuple):
    """least: part of the frames that are to be solved; most: that may be. reasons: one of them is in every other answer."""

    scene: Callable
    least: float
    most: float = 1.0
    reasons: tuple[str, ...] = ("patterns within tolerance", "happens by chance", "spots found")
    calmap: CalibrationMap = MAP
    fov_deg: float | None = None


TROUBLES = {
    "nothing": Trouble(nothing, 0, 0, ("spots found", "patterns within tolerance")),
    "two stars": Trouble(two_stars, 0, 0, ("spots found", "patterns within tolerance")),
    "600 hot pixels": Trouble(hot_pixels, 0.9),
    "planets and a satellite": Trouble(planets_and_a_satellite, 0.9),
    "clouds on half": Trouble(clouds_on_half, 0.8),
    "trees on the horizon": Trouble(trees, 0.9),
    "a Moon": Trouble(a_moon, 0.8),
    "saturated": Trouble(saturated, 0, 0, ("spots found",)),
    "twilight": Trouble(twilight, 0.5),
    "shaken": Trouble(shaken, 0),
    "date burnt in": Trouble(stamped, 0.9),
    "wrong pixel size": Trouble(as_it_is, 0, 0, ("wrong field suspected",), dataclasses.replace(MAP, intrinsics=WRONG_PX)),
    "field given 20 % too wide": Trouble(as_it_is, 0, 1.0, ("wrong field suspected",), NO_LENS, 1.2 * FOV_DEG),
    "field given 20 % too narrow": Trouble(as_it_is, 0, 1.0, ("wrong field suspected",), NO_LENS, 0.8 * FOV_DEG),
    "hot pixels, field unknown": Trouble(hot_pixels, 0.8, calmap=NO_LENS),
    "planets and a satellite, field unknown": Trouble(planets_and_a_satellite, 0.8, calmap=NO_LENS),
    "trees, field unknown": Trouble(trees, 0.8, calmap=NO_LENS),
}


class Outcome(NamedTuple):
    status: str
    reason: str
    wrong: bool
    warnings: tuple[str, ...] = ()


@pytest.fixture(scope="module")
def sky() -> Sky:
    return Sky()


def outcome(sky: Sky, trouble: Trouble, seed: int) -> Outcome:
    """What `solve` says of one frame of that kind."""
    rng = np.random.default_rng([60, seed])
    truth = Rotation.random(random_state=rng).as_matrix()
    stars = SkyCatalogue.seen_by(sky.table, Observer())
    xy = projection.project(LENS, stars.directions @ truth.T)
    on = ((xy > -6) & (xy < np.add(SIZE, 5))).all(1)
    light = points(xy[on], 3e5 * 10 ** (-0.4 * stars.magnitude[on]))
    data = np.clip(trouble.scene(light, rng), 0, WHITE).astype(np.uint16)
    frame = Frame(data=data, kind="light", bit_depth=12, white_level_dn=float(WHITE), exposure_s=0.1)
    solved = sky.solve(frame, trouble.calmap, fov_rad=np.radians(trouble.fov_deg) if trouble.fov_deg else None)
    solution = solved.solution
    wrong = False
    if solution.status == "solved":
        found = solution.identification
        away = projection.project(LENS, found.direction_icrs @ truth.T) - found.xy_px
        middle = projection.unproject(LENS, np.array([[375.5, 239.5]]))[0] @ truth
        ra, dec = solution.ra_rad, solution.dec_rad
        there = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        wrong = bool(not np.median(np.hypot(*away.T)) < 10 or np.degrees(np.linalg.norm(there - middle)) > 0.3)
    return Outcome(solution.status, solution.attitude.reason or "", wrong, solved.warnings)


@pytest.mark.parametrize("name", TROUBLES)
def test_right_or_said(sky, name):
    trouble = TROUBLES[name]
    for seed in range(2):
        found = outcome(sky, trouble, seed)
        assert not found.wrong
        if found.status == "solved":
            assert trouble.most > 0 and (trouble.fov_deg is None or "were given" in found.warnings[-1])
        else:
            assert any(reason in found.reason for reason in trouble.reasons), found
