"""Spots that would spoil the shape: each is set aside with a reason, and the map comes out as without them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.measure import psf
from calibench.records import Frame
from calibench.simulate.psf import render_sources
from calibench.simulate.pupil import Pupil
from calibench.spots.psf import light

SIZE = (300, 220)
LENS = Pupil(lambda_n_px=0.4, centre_px=(150.0, 110.0), corner_radius_px=186.0, coma_waves=0.04, diffusion_sigma_px=0.42)
SPOILT = {"ghost": 10, "drifting source": 17, "cosmic hit": 24, "two in one window": 31}


def places(rng):
    x, y = np.meshgrid(np.linspace(18, SIZE[0] - 19, 7), np.linspace(18, SIZE[1] - 19, 7))
    return np.rint(np.stack([x.ravel(), y.ravel()], -1)) + rng.uniform(-0.5, 0.5, (49, 2))


def frames(spoilt):
    """Two frames, 4e4 e- a spot; in the first, if wanted, one spot each with a fault."""
    rng, out, at = np.random.default_rng(4), [], {}
    for number in range(2):
        xy = places(rng)
        sources, flux = xy, np.full(len(xy), 4e4)
        if spoilt and number == 0:
            at = {name: xy[row] for name, row in SPOILT.items()}
            ghost, drift, blend = (xy[SPOILT[name]] for name in ("ghost", "drifting source", "two in one window"))
            sources = np.vstack([xy, ghost + (2.6, 1.2), drift + (1.3, 0.9), blend + (-1.6, 2.0), (30.0, 205.0 + 13)])
            flux = np.r_[flux, 4e3, 4e4, 2e4, 4e4]
        image = render_sources(LENS, sources, flux, SIZE) + 20
        data = np.rint(50 + 0.25 * (rng.poisson(image) + rng.normal(0, 10, image.shape)))
        if at and number == 0:
            column, row = np.rint(at["cosmic hit"]).astype(int) + (3, -2)
            data[row, column] += 2500
        out.append(Frame(data=data.clip(0, 65535).astype(np.uint16), kind="light", bit_depth=16, white_level_dn=65535,
                         egain_e_per_dn=4.0, file=f"{number}.png"))
    return out, at


@pytest.fixture(scope="module")
def measured():
    given, at = frames(True)
    return psf.measure(given), at


def kept(found):
    """(N, 2) places of the first frame's spots that the shape was fitted to."""
    used = found.evidence["spot_used"]
    xy, frame = found.evidence["spot_xy_px"][used], found.evidence["spot_frame"][used]
    return xy[found.evidence["shape_agrees"] & (frame == 0)]


@pytest.mark.parametrize("name", ["ghost", "drifting source", "two in one window"])
def test_a_spoilt_spot_is_not_fitted(measured, name):
    found, at = measured
    assert np.linalg.norm(kept(found) - at[name], axis=1).min() > 3
    assert any("set aside" in warning for warning in found.warnings)


def test_the_shape_is_that_of_the_sound_spots(measured):
    spoilt, _ = measured
    sound = psf.measure(frames(False)[0])
    assert not any("unlike the others" in warning for warning in sound.warnings)
    window = np.arange(-2.0, 3)
    for xy in ([150.0, 110.0], [60.0, 60.0]):
        images = [light(m.psf, np.array(xy), window, window) for m in (spoilt, sound)]
        assert np.abs(images[0] - images[1]).max() < 0.01 * images[1].max()


def test_spots_that_are_saturated_are_counted_among_those_set_aside():
    given, _ = frames(False)
    peak = np.sort(given[0].data.ravel())[-3]
    given[0] = dataclasses.replace(given[0], white_level_dn=float(peak))
    given[1] = dataclasses.replace(given[1], white_level_dn=float(peak))
    found = psf.measure(given)
    assert any("set aside" in warning and "saturated" in warning for warning in found.warnings)
