import numpy as np
import pytest
from astropy import units
from astropy.coordinates import SkyCoord
from scipy.spatial.transform import Rotation

from calibench.geometry import rotation, sphere


def test_quaternions_and_rotvecs_are_scipys():
    q = np.random.default_rng(2).normal(size=(200, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    matrices = Rotation.from_quat(q).as_matrix()
    np.testing.assert_allclose(rotation.matrix_from_quaternion(q), matrices, atol=1e-14)
    for one, m in zip(q, matrices, strict=True):
        np.testing.assert_allclose(rotation.quaternion_from_matrix(m), one * np.sign(one[3]), atol=1e-14)
        np.testing.assert_allclose(rotation.rotvec_from_matrix(m), Rotation.from_matrix(m).as_rotvec(), atol=1e-12)
    vectors = np.concatenate([np.zeros((1, 3)), q[:, :3] * 1e-8, q[:, :3] * 3])
    np.testing.assert_allclose(rotation.matrix_from_rotvec(vectors), Rotation.from_rotvec(vectors).as_matrix(), atol=1e-14)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_half_turns_keep_their_quaternion(axis):
    m = Rotation.from_rotvec(np.pi * np.eye(3)[axis]).as_matrix()
    np.testing.assert_allclose(np.abs(rotation.quaternion_from_matrix(m)), np.eye(4)[axis], atol=1e-15)


def test_pointing_and_roll_agree_with_astropy():
    rng = np.random.default_rng(3)
    for _ in range(50):
        ra, dec, roll = rng.uniform(0, 2 * np.pi), rng.uniform(-1.5, 1.5), rng.uniform(-np.pi, np.pi)
        r = sphere.camera_pointing_at(ra, dec, roll)
        assert np.linalg.det(r) == pytest.approx(1)
        centre, up = SkyCoord(ra, dec, unit="rad"), r.T @ [0, -1e-4, 1]
        back = sphere.radec_from_unit(up)
        angle = centre.position_angle(SkyCoord(*back, unit="rad")).to_value(units.rad)
        assert np.angle(np.exp(1j * (angle - roll))) == pytest.approx(0, abs=1e-3)
        right = SkyCoord(*sphere.radec_from_unit(r.T @ [1e-4, 0, 1]), unit="rad")
        seen = centre.position_angle(right).to_value(units.rad)  # with north up, right is west: 90 deg less than up
        assert np.angle(np.exp(1j * (seen - roll + np.pi / 2))) == pytest.approx(0, abs=1e-3)


def test_aberration_is_erfas():
    import erfa
    rng = np.random.default_rng(4)
    v = rng.normal(size=(20, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    velocity = np.array([0.6e-4, -0.7e-4, 0.3e-4])
    theirs = erfa.ab(v, velocity, 1e9, np.sqrt(1 - velocity @ velocity))  # the Sun far away: no deflection term
    seen = sphere.aberrate(v, velocity)
    assert np.max(sphere.angle_between(seen, theirs)) < 1e-12
    assert np.max(sphere.angle_between(seen, v)) > 5e-5
    np.testing.assert_allclose(sphere.remove_aberration(seen, velocity), v, atol=1e-15)
