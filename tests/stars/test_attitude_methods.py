import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibench import registry
from calibench.errors import BadInput

METHODS = registry.names("calibench.stars.attitude")


def cases(field: float, n: int, noise: float, count: int, seed: int = 1):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        camera = np.concatenate([rng.uniform(-field, field, (n, 2)), np.ones((n, 1))], 1)
        camera /= np.linalg.norm(camera, axis=1, keepdims=True)
        truth = Rotation.random(random_state=rng).as_matrix()
        noisy = camera + rng.normal(0, noise, camera.shape)
        yield noisy / np.linalg.norm(noisy, axis=1, keepdims=True), camera @ truth, truth


@pytest.mark.parametrize("method", METHODS)
def test_exact_data_give_the_exact_attitude(method):
    attitude = registry.load("calibench.stars.attitude", method).attitude
    for camera, sky, truth in cases(0.2, 5, 0, 300):
        np.testing.assert_allclose(attitude(camera, sky, np.ones(5)), truth, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_noisy_data_agree_with_scipy(method):
    attitude = registry.load("calibench.stars.attitude", method).attitude
    for camera, sky, _ in cases(0.15, 6, 1e-4, 200):
        weights = np.arange(1.0, 7)
        theirs = Rotation.align_vectors(camera, sky, weights=weights)[0].as_matrix()
        np.testing.assert_allclose(attitude(camera, sky, weights), theirs, atol=2e-9)


@pytest.mark.parametrize("method", METHODS)
def test_half_turns_lose_nothing(method):
    attitude = registry.load("calibench.stars.attitude", method).attitude
    for camera, _, _ in cases(0.2, 4, 0, 20):
        for axis in (*np.eye(3), np.array([1, 1, 0]) / 2**0.5, np.array([1, 1, 1]) / 3**0.5):
            for near in (0.0, 1e-9, 1e-6):
                truth = Rotation.from_rotvec((np.pi - near) * axis).as_matrix()
                np.testing.assert_allclose(attitude(camera, camera @ truth, np.ones(4)), truth, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_what_has_no_attitude_is_refused(method):
    attitude = registry.load("calibench.stars.attitude", method).attitude
    v = np.array([[0.0, 0, 1]])
    with pytest.raises(BadInput, match="at least two"):
        attitude(v, v, np.ones(1))
    with pytest.raises(BadInput, match="parallel"):
        attitude(np.repeat(v, 3, 0), np.repeat(v, 3, 0), np.ones(3))
