import numpy as np
import pytest
from scipy.special import erf

from calibench import registry
from calibench.records import DEFECT_FLAGS, SPOT_FLAGS, CorrectedFrame, PsfMap
from calibench.spots.find import find_spots

SIZE = (240, 160)
GAIN, READ_DN, LEVEL_DN = 0.5, 3.0, 40.0


def render(xy, flux_e, sigma, rng):
    """Gaussian spots integrated over pixels (erf), with photon and read noise: independent of the fitted model's quadrature."""
    w, h = SIZE
    light = np.zeros((h, w))
    for (x, y), f in zip(xy, np.broadcast_to(flux_e, len(xy)), strict=True):
        across = [np.diff(erf((np.arange(n + 1) - 0.5 - c) / (2**0.5 * sigma))) / 2 for n, c in ((w, x), (h, y))]
        light += f * np.outer(across[1], across[0])
    return (rng.poisson(light + LEVEL_DN / GAIN) * GAIN + rng.normal(0, READ_DN, (h, w))).astype(np.float32)


def frame(data, defects=None):
    return CorrectedFrame(signal_dn=data, variance_dn2=np.full(data.shape, READ_DN**2 + LEVEL_DN * GAIN, np.float32),
                          defects=np.zeros(data.shape, np.uint16) if defects is None else defects, gain_dn_per_e=GAIN)


def grid(rng):
    x, y = np.meshgrid(np.arange(20, 230, 30), np.arange(20, 150, 30))
    return np.stack([x.ravel(), y.ravel()], -1) + rng.uniform(-0.5, 0.5, (x.size, 2))


def nearest(spots, xy):
    distance = np.linalg.norm(spots.xy_px[:, None] - xy[None], axis=-1)
    return distance.argmin(0), distance.min(0)


@pytest.mark.parametrize("detector", registry.names("calibench.spots.detect"))
@pytest.mark.parametrize("centroider", registry.names("calibench.spots.centroid"))
def test_every_detector_and_centroider_finds_bright_spots(detector, centroider):
    rng = np.random.default_rng(3)
    xy = grid(rng)
    spots = find_spots(frame(render(xy, 8000, 0.9, rng)), PsfMap.unknown(SIZE), detector=detector, centroider=centroider)
    _, distance = nearest(spots, xy)
    assert distance.max() < 0.5
    assert len(spots) <= len(xy) + 1


@pytest.mark.parametrize("sigma", [0.6, 1.0, 1.4])
def test_gaussian_centroids_reach_their_own_honest_covariance(sigma):
    rng = np.random.default_rng(4)
    psf = PsfMap.unknown(SIZE, sigma)
    squares, errors, flux = [], [], []
    for _ in range(25):
        xy = grid(rng)
        spots = find_spots(frame(render(xy, 5000, sigma, rng)), psf, psf_known=True)
        row, distance = nearest(spots, xy)
        assert distance.max() < 0.3
        error = spots.xy_px[row] - xy
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(spots.covariance_px2[row]), error) / 2)
        errors.append(error)
        flux.append(spots.flux_e[row])
    # The covariance carries 1 % of model error and is never scaled down, so it may be a little wide, and never narrow.
    assert 0.75 < np.mean(squares) < 1.05
    assert np.abs(np.mean(errors)) < 0.003
    assert np.mean(flux) == pytest.approx(5000, rel=0.01)


@pytest.mark.parametrize("centroider", registry.names("calibench.spots.centroid"))
def test_a_saturated_spot_is_not_believed_to_the_hundredth_of_a_pixel(centroider):
    rng = np.random.default_rng(6)
    xy = grid(rng)
    full, squares = 3000.0, []
    for _ in range(6):
        data = render(xy, 60000, 0.9, rng)
        defects = np.where(data >= full, np.uint16(DEFECT_FLAGS["saturated"]), np.uint16(0))
        spots = find_spots(frame(np.minimum(data, full), defects), PsfMap.unknown(SIZE, 0.9), psf_known=True,
                           centroider=centroider)
        row, distance = nearest(spots, xy)
        assert distance.max() < 1.5 and (spots.flags[row] & SPOT_FLAGS["saturated"]).all()
        error = spots.xy_px[row] - xy
        squares.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(spots.covariance_px2[row]), error) / 2)
    assert np.mean(squares) < 3


def test_false_alarms_on_pure_noise_stay_rare():
    rng = np.random.default_rng(5)
    found = sum(len(find_spots(frame(render(np.zeros((0, 2)), 0, 1, rng)), PsfMap.unknown(SIZE), detector="components"))
                for _ in range(30))
    assert found <= 3  # 30 frames of 38400 pixels at 5 sigma


def test_flags_say_what_is_wrong_with_a_spot():
    rng = np.random.default_rng(6)
    xy = np.array([[60.2, 60.1], [120.4, 80.3], [1.2, 100.0], [180.0, 40.0]])
    data = render(xy, 20000, 1.0, rng)
    defects = np.zeros(data.shape, np.uint16)
    defects[60, 60] = DEFECT_FLAGS["saturated"]
    defects[80, 121] = DEFECT_FLAGS["hot"]
    spots = find_spots(frame(data, defects), PsfMap.unknown(SIZE))
    row, distance = nearest(spots, xy)
    assert distance.max() < 0.5
    for i, name in enumerate(("saturated", "defect", "edge")):
        assert spots.flags[row[i]] & SPOT_FLAGS[name], name
    assert spots.flags[row[3]] == 0


def test_a_hot_pixel_is_no_spot_and_a_masked_one_does_not_move_its_neighbour():
    rng = np.random.default_rng(7)
    xy = np.array([[100.3, 80.2]])
    data = render(xy, 20000, 1.0, rng)
    data[40, 40] += 900
    data[81, 101] += 2000
    defects = np.zeros(data.shape, np.uint16)
    defects[81, 101] = DEFECT_FLAGS["hot"]
    spots = find_spots(frame(data, defects), PsfMap.unknown(SIZE), false_alarms=0.01)
    assert len(spots) == 1
    np.testing.assert_allclose(spots.xy_px, xy, atol=0.05)
