"""The sphere: unit vectors, right ascension and declination, pointing and roll, aberration, refraction."""

from __future__ import annotations

import math

import numpy as np

from ..records import Observer, Refraction

LEAST_COSINE = 0.05  # altitude 2.9 degrees, below which ERFA's formula is held where it is
INVERSE_STEPS = 8


def unit_from_radec(ra_rad: np.ndarray, dec_rad: np.ndarray) -> np.ndarray:
    """Right ascension and declination, rad (...) -> unit vectors (..., 3)."""
    ra, dec = np.asarray(ra_rad, float), np.asarray(dec_rad, float)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], -1)


def radec_from_unit(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (..., 3) of any length -> (ra in [0, 2 pi), dec), rad."""
    x, y, z = np.moveaxis(np.asarray(v, float), -1, 0)
    return np.arctan2(y, x) % (2 * np.pi), np.arctan2(z, np.hypot(x, y))


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between vectors (..., 3), rad; exact for small and for large angles."""
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(np.asarray(a) * b, axis=-1))


def north_and_east(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangent vectors towards north and east at one direction (3,); at a pole, east is that of ra = 0."""
    v = np.asarray(v, float) / np.linalg.norm(v)
    east = np.cross([0.0, 0.0, 1.0], v)
    length = np.linalg.norm(east)
    east = east / length if length > 1e-12 else np.array([0.0, 1.0, 0.0])
    return np.cross(v, east), east


def position_angle(at: np.ndarray, towards: np.ndarray) -> float:
    """Position angle, rad in (-pi, pi], east of north, of the direction `towards` (3,) seen from `at` (3,)."""
    (x, y, z), (u, v, w) = np.asarray(at, float).tolist(), np.asarray(towards, float).tolist()
    length2 = x * x + y * y + z * z
    if math.hypot(x, y) <= 1e-12 * math.sqrt(length2):
        north, east = north_and_east(at)
        return float(np.arctan2(np.dot(towards, east), np.dot(towards, north)))
    return math.atan2((x * v - y * u) * math.sqrt(length2), w * length2 - z * (x * u + y * v + z * w))


def camera_pointing_at(ra_rad: float, dec_rad: float, roll_rad: float) -> np.ndarray:
    """R_cam_icrs (3, 3) of a camera whose boresight z looks at (ra, dec).

    roll_rad: position angle, east of north, of image up (-y) at the boresight. Seen from inside the sphere with north up,
    east is to the left, so with roll 0 the x axis (right) points west.
    """
    z = unit_from_radec(ra_rad, dec_rad)
    north, east = north_and_east(z)
    up = np.cos(roll_rad) * north + np.sin(roll_rad) * east
    return np.stack([np.cross(-up, z), -up, z])


def aberrate(v: np.ndarray, velocity_c: np.ndarray) -> np.ndarray:
    """Directions (..., 3) as seen by an observer moving at velocity_c (3,), in units of c.

    The exact special-relativistic form (Explanatory Supplement, 3rd ed., eq. 7.40): up to 20.5 arcsec for the Earth.
    """
    v, beta = np.asarray(v, float), np.asarray(velocity_c, float)
    inverse_gamma = np.sqrt(1 - beta @ beta)
    dot = (v @ beta)[..., None]
    seen = (inverse_gamma * v + beta + dot * beta / (1 + inverse_gamma)) / (1 + dot)
    return seen / np.linalg.norm(seen, axis=-1, keepdims=True)


def remove_aberration(v: np.ndarray, velocity_c: np.ndarray) -> np.ndarray:
    """The inverse of `aberrate`: the same boost with the opposite velocity."""
    return aberrate(v, -np.asarray(velocity_c, float))


def refract(v: np.ndarray, refraction: Refraction) -> np.ndarray:
    """Directions (..., 3) as seen through the air: raised towards the zenith; below 2.9 degrees of altitude the bend is held.

    "erfa": dz = A tan z + B tan^3 z of the observed z, from the true one by one Newton step (ERFA, eraAtioq).
    "bennett": R = cot(h + 7.31 / (h + 4.4)) arcmin of the apparent altitude h, degrees (Bennett 1982), found by iteration.
    """
    v, zenith = np.asarray(v, float), refraction.zenith_icrs
    cosine = (v @ zenith)[..., None]
    level = v - cosine * zenith
    sine = np.maximum(np.linalg.norm(level, axis=-1, keepdims=True), 1e-6)
    held = np.maximum(cosine, LEAST_COSINE)
    if refraction.model == "erfa":
        a, b = refraction.constants_rad
        tangent = sine / held
        cubic = b * tangent**2
        bent = (a + cubic) * tangent / (1 + (a + 3 * cubic) / held**2)
    else:
        true_deg = np.degrees(np.arctan2(held, sine))
        bent = np.zeros_like(true_deg)
        for _ in range(INVERSE_STEPS):
            h = true_deg + np.degrees(bent)
            bent = refraction.constants_rad[0] / np.tan(np.radians(h + 7.31 / (h + 4.4)))
    return v * np.cos(bent) + (sine * zenith - cosine * level / sine) * np.sin(bent)


def remove_refraction(v: np.ndarray, refraction: Refraction) -> np.ndarray:
    """The inverse of `refract`."""
    v = np.asarray(v, float)
    true = v
    for _ in range(INVERSE_STEPS):
        true = true + v - refract(true, refraction)
        true = true / np.linalg.norm(true, axis=-1, keepdims=True)
    return true


def as_seen(v: np.ndarray, observer: Observer) -> np.ndarray:
    """Geometric directions (..., 3), ICRS axes, as the observer sees them: aberration, then refraction."""
    seen = aberrate(v, observer.velocity_c)
    return seen if observer.refraction is None else refract(seen, observer.refraction)


def as_catalogued(v: np.ndarray, observer: Observer) -> np.ndarray:
    """The inverse of `as_seen`: where a catalogue says that a seen direction (..., 3) is."""
    if observer.refraction is not None:
        v = remove_refraction(v, observer.refraction)
    return remove_aberration(v, observer.velocity_c)
