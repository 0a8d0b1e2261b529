import numpy as np
import pytest

from calibench.spots.background import background_and_noise, busy_area


def test_level_gradient_and_noise_are_found_under_stars():
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:300, :410]
    level = 100 + 0.05 * x + 0.02 * y
    image = level + rng.normal(0, 3.0, level.shape)
    for cx, cy in rng.uniform(5, 295, (60, 2)):
        image += 500 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 3)
    background, noise = background_and_noise(image)
    assert np.abs(background - level).max() < 2.5
    assert np.median(noise) == pytest.approx(3.0, rel=0.05)


def test_eight_bit_frames_keep_a_noise_floor():
    image = np.ones((128, 128))
    image[::7, ::5] = 2
    background, noise = background_and_noise(image)
    assert np.isfinite(background).all()
    assert (noise >= 0.3).all() and noise.max() < 1


def test_masked_pixels_do_not_count():
    image = np.full((96, 96), 10.0)
    mask = np.zeros(image.shape, bool)
    mask[:, ::2] = True
    image[mask] = 1e6
    background, _ = background_and_noise(image, mask)
    np.testing.assert_allclose(background, 10, atol=1e-3)


def test_restless_areas_are_told():
    rng = np.random.default_rng(2)
    image = rng.normal(20, 1, (256, 256))
    image[:, 192:] += rng.normal(0, 15, (256, 64))
    busy = busy_area(background_and_noise(image)[1])
    assert busy[:, 210:].mean() > 0.95 and busy[:, :160].mean() < 0.05


def test_where_no_light_falls_the_noise_of_the_rest_counts():
    """Beyond the image circle all pixels are of one value: no noise of 0.3 DN, beside which the sky would be restless."""
    rng = np.random.default_rng(3)
    image = np.rint(rng.normal(20, 2, (384, 384)))
    y, x = np.mgrid[:384, :384]
    lit = np.hypot(x - 192, y - 192) < 170
    noise = background_and_noise(np.where(lit, image, 0))[1]
    assert np.quantile(noise, 0.1) > 1.5 and busy_area(noise)[lit].mean() < 0.02
