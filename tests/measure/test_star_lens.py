"""Intrinsics from stars: truth from simulated identifications, error bars, frames that do not belong, bad input."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.geometry import projection
from calibench.geometry.rotation import matrix_from_quaternion, matrix_from_rotvec
from calibench.measure import star_lens
from calibench.records import DISTORTION_NAMES, Identification, Intrinsics

SIZE = (752, 480)
TRUTH = Intrinsics(model="brown4", fx_px=1416.0, fy_px=1417.0, cx_px=370.0, cy_px=245.0, image_size_px=SIZE,
                   distortion=[-0.37, 0.31, -2e-3, 3e-4], covariance=np.zeros((8, 8)))
GUESS = Intrinsics.pinhole(focal_px=1440.0, image_size_px=SIZE)


def frames_of(rng, *, frames=10, stars=40, sigma_px=0.1, said_px=None, lens=TRUTH):
    """Identifications of random stars; said_px: what their covariance claims."""
    said = (said_px or sigma_px) ** 2 * np.eye(2)
    out = []
    for i in range(frames):
        turn = matrix_from_rotvec(rng.normal(0, 1, 3))
        xy = rng.uniform((5, 5), np.array(SIZE) - 6, (stars, 2))
        out.append(Identification(
            status="solved", method="test", file=f"sky{i}.fits", spot_rows=np.arange(stars), star_rows=np.arange(stars),
            xy_px=xy + rng.normal(0, sigma_px, xy.shape), covariance_px2=np.tile(said, (stars, 1, 1)),
            direction_icrs=projection.unproject(lens, xy) @ turn, intrinsics=GUESS))
    return out


def test_an_unknown_lens_is_found_from_stars_alone():
    result = star_lens.measure(frames_of(np.random.default_rng(0)))
    sd = np.sqrt(np.diag(result.intrinsics.covariance))
    assert result.intrinsics.model == "brown4"
    assert (np.abs(result.intrinsics.parameters - TRUTH.parameters) < 4 * sd).all()
    assert sd[0] < 0.3
    assert result.quantity("rms_px").value == pytest.approx(0.14, abs=0.01)
    assert result.quantity("held_out_over_predicted").value == pytest.approx(1, abs=0.06)
    assert result.quantity("points").value == 400 and result.frames_used == 10
    xy, v = result.evidence["stars_xy_px"], result.evidence["stars_direction_icrs"]
    turns = matrix_from_quaternion(result.evidence["attitudes_q_cam_icrs"])[result.evidence["stars_view"]]
    seen = projection.project(result.intrinsics, np.einsum("nij,nj->ni", turns, v))
    np.testing.assert_allclose(xy - seen, result.evidence["residual_px"], atol=1e-9)


@pytest.mark.parametrize("model", ["pinhole", "brown4", "brown5", "rational8"])
def test_every_model_can_be_asked_for(model):
    result = star_lens.measure(frames_of(np.random.default_rng(1)), star_lens.Settings(model=model))
    assert result.intrinsics.model == model and len(result.intrinsics.distortion) == len(DISTORTION_NAMES[model])
    asked_too_little = any("pinhole was asked for" in warning for warning in result.warnings)
    assert asked_too_little == (model == "pinhole")


def test_pinhole_is_enough_for_a_lens_without_distortion():
    ideal = dataclasses.replace(TRUTH, distortion=np.zeros(4))
    assert star_lens.measure(frames_of(np.random.default_rng(2), lens=ideal)).intrinsics.model == "pinhole"


def test_error_beyond_the_centroids_own_is_found_and_counted():
    honest = star_lens.measure(frames_of(np.random.default_rng(3), sigma_px=0.2))
    bold = star_lens.measure(frames_of(np.random.default_rng(3), sigma_px=0.2, said_px=0.02))
    assert honest.quantity("extra_sd_px").value < 0.06
    assert bold.quantity("extra_sd_px").value == pytest.approx(0.2, abs=0.015)
    assert bold.quantity("fx_px").uncertainty == pytest.approx(honest.quantity("fx_px").uncertainty, rel=0.15)


def test_wrong_stars_and_a_wrong_frame_are_left_out():
    rng = np.random.default_rng(4)
    frames = frames_of(rng)
    wild = frames[3].xy_px.copy()
    wild[5] += 8
    frames[3] = dataclasses.replace(frames[3], xy_px=wild)
    frames[7] = dataclasses.replace(frames[7], xy_px=frames[7].xy_px + rng.normal(0, 20, (40, 2)))
    few = slice(0, 3)
    frames.append(dataclasses.replace(frames[0], file="few.fits", spot_rows=np.arange(3), star_rows=np.arange(3),
                                      xy_px=frames[0].xy_px[few], covariance_px2=frames[0].covariance_px2[few],
                                      direction_icrs=frames[0].direction_icrs[few]))
    frames.append(Identification(status="no_match", method="test", reason="clouds", file="cloud.fits"))
    result = star_lens.measure(frames)
    reasons = dict(result.frames_rejected)
    assert set(reasons) == {"sky7.fits", "few.fits", "cloud.fits"} and reasons["cloud.fits"] == "clouds"
    assert result.frames_used == 9
    missed = ~result.evidence["inlier"] & (result.evidence["stars_view"] == 3)
    assert missed.sum() >= 1 and np.hypot(*result.evidence["residual_px"][missed].T).max() > 8
    assert abs(result.intrinsics.fx_px - 1416) < 4 * result.quantity("fx_px").uncertainty


def test_too_few_frames_and_two_cameras_are_refused():
    frames = frames_of(np.random.default_rng(5), frames=3)
    with pytest.raises(BadInput, match="2 are the least"):
        star_lens.measure(frames[:1])
    other = dataclasses.replace(GUESS, mirrored=True)
    with pytest.raises(BadInput, match="differ in size or handedness"):
        star_lens.measure([*frames, dataclasses.replace(frames[0], intrinsics=other)])


def test_few_frames_do_without_a_model_choice():
    result = star_lens.measure(frames_of(np.random.default_rng(6), frames=3))
    assert result.intrinsics.model == "brown4"
    assert result.quantity("held_out_rms_px").value is None and result.quantity("held_out_rms_px").reason
