"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does, before numpy loads

import numpy as np
import pytest

from calibench.geometry.projection import project
from calibench.geometry.rotation import matrix_from_rotvec
from calibench.measure._bundle.boards import board_points_mm, bow_shape
from calibench.records import Frame

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's root folder."""
    return ROOT


@pytest.fixture(scope="session")
def real() -> Path:
    """The folder of real frames; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("CALIBENCH_REAL", ROOT.parent / "shared" / "real"))
    if not folder.is_dir():
        pytest.skip("real frames are not on this machine (set CALIBENCH_REAL to their folder)")
    return folder


@pytest.fixture(scope="session")
def board_corners():
    """Function of (lens, rng, ...) that gives the points (P, 3) mm of a board and its corners (V, P, 2) px before the lens."""
    def seen(lens, rng, *, views=13, sigma_px=0.1, bow_mm=(0.0, 0.0), board=(9, 6), square_mm=25.0):
        points = board_points_mm(board, square_mm)
        shaped = points + np.outer(bow_shape(points) @ bow_mm, (0, 0, 1))
        size, far = np.array(lens.image_size_px), np.ptp(points[:, 0]) * lens.fx_px / lens.image_size_px[0]
        out = []
        while len(out) < views:
            turn = matrix_from_rotvec(np.append(rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3)))
            place = np.append(rng.uniform(-0.35, 0.35, 2), 1) * rng.uniform(1.1, 2.0) * far
            xy = project(lens, (shaped - points.mean(axis=0)) @ turn.T + place)
            if ((xy > 3) & (xy < size - 4)).all():
                out.append(xy)
        return points, np.array(out) + rng.normal(0, sigma_px, (views, len(points), 2))
    return seen


@pytest.fixture(scope="session")
def light_ladder():
    """Function that gives the frames of a photon transfer series of a linear sensor, one by one, darks last.

    dsnu, prnu: sd of (pixels, rows, columns) in e- and as a part of the response. bend: of the response at full range.
    coupling, lag: part of a charge that shows in each of its four neighbours, that is read with the next frame.
    """
    def frames(seed, *, size_px=(96, 64), levels=20, stack=30, gain=0.25, qe=0.6, read_e=4.0, offset_dn=60.0, bits=12,
               dsnu=(3.0, 1.0, 1.5), prnu=(0.01, 0.004, 0.003), rate_e_per_s=20.0, reach=1.1, well_e=np.inf, longest_s=0.02,
               bend=0.0, share=0.0, coupling=0.0, lag=0.0, flicker=0.0, bayer=None, darks=True):
        rng, (w, h) = np.random.default_rng(seed), size_px
        shapes = ((h, w), (h, 1), (1, w))
        pattern_e, response = (sum(sd * rng.standard_normal(shape) for sd, shape in zip(sds, shapes, strict=True))
                               for sds in (dsnu, prnu))
        pattern_e, response = pattern_e - pattern_e.mean(), 1 + response - response.mean()
        white, left_e = 2**bits - 1, 0.0
        full_e = (white - offset_dn) / gain
        for kind in ("flat", "dark") if darks else ("flat",):
            for i, t in enumerate(np.linspace(longest_s / levels, longest_s, levels)):
                photons = reach * full_e / qe * t / longest_s * (kind == "flat")
                for j in range(2 + stack * (i == levels // 2 - 1)):
                    light = qe * photons * response * (1 + flicker * rng.standard_normal())
                    e = np.minimum(rng.poisson(light + rate_e_per_s * t), well_e)
                    e = e - share * (e - np.roll(e, 1, axis=1))  # a part of each charge is read with the next pixel
                    e, left_e = (1 - lag) * e + left_e, lag * e
                    for axis in (0, 1) if coupling else ():
                        e = e + coupling * (np.roll(e, 1, axis) + np.roll(e, -1, axis) - 2 * e)
                    e = e * (1 - bend * e / full_e) + read_e * rng.standard_normal((h, w)) + pattern_e
                    data = np.rint(gain * e + offset_dn).clip(0, white).astype(np.uint16)
                    yield Frame(data=data, kind=kind, bit_depth=bits, white_level_dn=white, exposure_s=float(t),
                                bayer_pattern=bayer, photons_per_px=float(photons), file=f"{kind}_{i:02d}_{j:02d}")
    return frames
