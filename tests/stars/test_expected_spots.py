"""Tracking measures what `solve` measures: the same corrected windows, the same centroids, with every layer of a map."""

import dataclasses

import numpy as np
import pytest

from calibench.calmap.correct import correct
from calibench.calmap.windows import SeriesLayers, WindowLayers
from calibench.records import DEFECT_FLAGS, UNUSABLE, CalibrationMap, Frame, HermiteShape, PsfMap
from calibench.spots import hermite
from calibench.spots.candidates import Candidates
from calibench.spots.centroid import psf_map
from calibench.spots.scene import FrameScene
from calibench.stars.find_stars import FindState, find_stars
from calibench.stars.tracking.expected import ExpectedScene, Expecting

SIZE, GAIN, EXPOSURE_S = (200, 160), 0.4, 0.2
SHAPE = SIZE[::-1]
MEASURED = frozenset({"offset_dn", "dark_rate_dn_per_s", "dark_rate_uncertainty_dn_per_s", "dark_reference_c",
                      "dark_activation_ev", "response", "read_noise_dn", "gain_dn_per_e", "defects", "linearity_dn",
                      "saturation_dn", "psf"})
PLACES = np.stack(np.meshgrid(np.arange(20, 190, 32), np.arange(20, 150, 32)), -1).reshape(-1, 2) + [0.3, -0.2]


def lopsided() -> PsfMap:
    coefficients = np.zeros((hermite.free_functions(4).shape[1], 1))
    coefficients[:, 0] = np.random.default_rng(1).normal(0, 0.006, len(coefficients))
    shape = HermiteShape(order=4, degree=0, scale_px=0.8, coefficients=coefficients, radius_px=5, core_residual=0.002,
                         dither_coverage=1.0)
    return PsfMap(model="gauss_hermite", degree=0, coefficients=np.array([[0.64], [0.64], [0.0]]), image_size_px=SIZE,
                  centre="", measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0, hermite=shape)


@pytest.fixture(scope="module")
def calmap() -> CalibrationMap:
    """Every layer that a corrected frame depends on."""
    rng = np.random.default_rng(2)
    dark = rng.exponential(30, SHAPE)
    hot = rng.random(SHAPE) < 0.004
    dark[hot] += rng.exponential(400, hot.sum())
    images = {"offset_dn": rng.normal(60, 3, SHAPE), "dark_rate_dn_per_s": dark, "response": rng.normal(1, 0.02, SHAPE),
              "read_noise_dn": rng.uniform(1.5, 2.5, SHAPE), "dark_rate_uncertainty_dn_per_s": np.full(SHAPE, 0.5)}
    return CalibrationMap(image_size_px=SIZE, measured=MEASURED, gain_dn_per_e=GAIN, dark_reference_c=20.0,
                          dark_activation_ev=0.6, saturation_dn=3900.0, psf=lopsided(),
                          linearity_dn=np.array([[0, 0], [300, 306], [1500, 1590], [4000, 4440]]),
                          defects=(hot * DEFECT_FLAGS["hot"]).astype(np.uint16),
                          **{name: image.astype(np.float32) for name, image in images.items()})


@pytest.fixture(scope="module")
def frame(calmap) -> Frame:
    """A sky of stars 8 degrees warmer than the darks were, as the camera of the map shows it."""
    rng, light, shape = np.random.default_rng(3), np.full(SHAPE, 150.0), calmap.psf.hermite
    for (x, y), place in zip(PLACES, hermite.coefficients_at(shape, PLACES, SIZE), strict=True):
        light += 12000 * hermite.image(place, shape, np.arange(SIZE[0]) - x, np.arange(SIZE[1]) - y)
    warm = 2.0  # about: the test compares two ways to correct, not with the truth
    charge = GAIN * rng.poisson(np.maximum(light, 0) * calmap.response + calmap.dark_rate_dn_per_s * EXPOSURE_S * warm / GAIN)
    measured = np.interp(charge, calmap.linearity_dn[:, 1], calmap.linearity_dn[:, 0])
    data = np.rint(calmap.offset_dn + measured + rng.normal(0, calmap.read_noise_dn))
    return Frame(data=data.clip(0, 4095).astype(np.uint16), bit_depth=12, white_level_dn=4095.0, exposure_s=EXPOSURE_S,
                 temperature_c=28.0)


def test_a_tracked_spot_is_that_of_the_frame_corrected_whole(calmap, frame):
    """The same windows, the same centroid to 1e-6 px; the noise is that of `correct` under this sky."""
    layers, corrected = WindowLayers.of(frame, calmap), correct(frame, calmap)
    unusable = (corrected.defects & UNUSABLE) != 0
    for k, place in enumerate(PLACES):
        at, nothing = place[None] + 0.2, np.zeros(1)
        candidate = Candidates(xy_px=at, peak_xy=np.rint(at).astype(np.int64), peak_dn=nothing, flux_dn=nothing, pixels=nothing,
                               elongation=nothing + 1, blend=nothing > 0)
        sky = 55.0 + k
        scene = ExpectedScene(data=frame.data, layers=layers, psf=calmap.psf, psf_known=True, shape_px2=None,
                              background_dn=nothing + sky, noise_dn2=nothing)
        charge = np.float32(sky) * calmap.response + layers.dark_dn
        slope = np.array([306 / 300, 1284 / 1200, 2850 / 2500])[np.searchsorted([306, 1590], charge)]
        floor = (slope**2 * layers.read_variance_dn2 + GAIN * charge) / calmap.response**2
        whole = FrameScene(signal_dn=corrected.signal_dn - np.float32(sky), floor_variance_dn2=floor, unusable=unusable,
                           gain_dn_per_e=GAIN, psf=calmap.psf, psf_known=True)
        for name in ("signal_dn", "floor_variance_dn2"):
            ours, theirs = (getattr(one.patches(candidate.peak_xy, 5), name) for one in (scene, whole))
            inside = np.isfinite(theirs)
            np.testing.assert_array_equal(np.isfinite(ours) & inside, inside)
            np.testing.assert_allclose(ours[inside], theirs[inside], rtol=1e-5, atol=1e-4)
        ours, theirs = psf_map.centroid(scene, candidate), psf_map.centroid(whole, candidate)
        assert ours.ok[0] == theirs.ok[0]
        if ours.ok[0]:
            np.testing.assert_allclose(ours.xy_px, theirs.xy_px, atol=1e-6)
            np.testing.assert_allclose(ours.covariance_px2, theirs.covariance_px2, rtol=1e-4)


def test_tracking_finds_what_solve_finds(calmap, frame):
    """From places that are predicted and from a scan: to a small part of the error bar, which differs by its noise alone."""
    solved = find_stars(frame, calmap, FindState())
    seen, tracked = Expecting(calmap=calmap).measure(frame.data, WindowLayers.of(frame, calmap), PLACES + [1.4, -2.2],
                                                     np.zeros_like(PLACES), 6)
    assert len(seen) > 0.7 * len(PLACES)  # those near a defect are left out
    apart = np.linalg.norm(tracked.xy_px[:, None] - solved.xy_px, axis=-1)
    same = apart.argmin(1)
    sd = np.sqrt(np.einsum("nii->n", tracked.covariance_px2))
    assert (apart.min(1) < 0.15 * sd).all()
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->n", solved.covariance_px2[same])), sd, rtol=0.1)
    np.testing.assert_allclose(solved.background_dn[same], tracked.background_dn, atol=1.5)


def test_frames_of_another_temperature_get_layers_of_their_own(calmap, frame):
    series = SeriesLayers(calmap)
    first = series.of(frame)
    assert series.of(dataclasses.replace(frame, data=frame.data + 1)) is first
    colder = series.of(dataclasses.replace(frame, temperature_c=10.0))
    assert colder.dark_dn.mean() < 0.5 * first.dark_dn.mean()
    assert (colder.defects & DEFECT_FLAGS["hot"]).astype(bool).sum() < (first.defects & DEFECT_FLAGS["hot"]).astype(bool).sum()
