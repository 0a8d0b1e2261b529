"""The night sky through the simulated camera: catalogue stars at an attitude, background, false stars, cosmic hits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.projection import project
from ..geometry.sphere import aberrate, unit_from_radec
from ..records import Observer, StarTable
from .camera import SimulatedCamera
from .photometry import sky_electrons_per_s, star_electrons_per_s
from .psf import chief_ray_px, render_sources

_RAD_PER_MAS = np.pi / (180 * 3600e3)


@dataclass(frozen=True, kw_only=True)
class SkyConditions:
    """What lies over the catalogue stars. sky_mag_arcsec2: V brightness of the background; false_stars: points that no
    catalogue has (satellites, planets), V 2.5 to 5; cosmic_hits: short tracks of charge."""

    sky_mag_arcsec2: float = 20.0
    false_stars: int = 0
    cosmic_hits: int = 0


@dataclass(frozen=True, kw_only=True)
class StarField:
    """light_e (H, W): expected electrons. star_rows (N,): rows of the StarTable on the image, brightest first.

    xy_px (N, 2) centres of mass, chief_ray_px (N, 2), flux_e (N,). false_xy_px (M, 2): of the false stars;
    cosmic_xy_px (K, 2): where the tracks start.
    """

    light_e: np.ndarray
    star_rows: np.ndarray
    xy_px: np.ndarray
    chief_ray_px: np.ndarray
    flux_e: np.ndarray
    false_xy_px: np.ndarray
    cosmic_xy_px: np.ndarray


def apparent_directions(stars: StarTable, observer: Observer) -> np.ndarray:
    """(N, 3) unit vectors of the stars, ICRS axes, as the observer sees them: proper motion, parallax, aberration.

    A star without proper motion or parallax in the table has none here.
    """
    ra, dec = stars.ra_rad, stars.dec_rad
    v = unit_from_radec(ra, dec)
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros_like(ra)], -1)
    north = np.cross(v, east)
    motion, parallax = (np.nan_to_num(np.asarray(a, float)) * _RAD_PER_MAS
                        for a in (np.stack([stars.pm_ra_mas_yr, stars.pm_dec_mas_yr], -1), stars.parallax_mas))
    years = observer.epoch_jyear - stars.epoch_jyear
    v = v + years * (motion[:, :1] * east + motion[:, 1:] * north) - parallax[:, None] * observer.position_au
    return aberrate(v / np.linalg.norm(v, axis=-1, keepdims=True), observer.velocity_c)


def star_field(camera: SimulatedCamera, stars: StarTable, r_cam_icrs: np.ndarray, *, exposure_s: float,
               conditions: SkyConditions, observer: Observer, rng: np.random.Generator) -> StarField:
    """Expected electrons of one exposure of the sky at attitude r_cam_icrs (3, 3), v_cam = r_cam_icrs v_icrs.

    Stars without a V magnitude give no light. No refraction, no smear.
    """
    width, height = camera.image_size_px
    xy_px = project(camera.intrinsics, apparent_directions(stars, observer) @ r_cam_icrs.T)
    lit = _on_image(xy_px, (width, height)) & np.isfinite(stars.v_mag)
    rows = np.flatnonzero(lit)
    rows = rows[np.argsort(stars.v_mag[rows], kind="stable")]
    xy_px = xy_px[rows]
    flux_e = star_electrons_per_s(camera, stars.v_mag[rows]) * exposure_s * _transmission_at(camera, xy_px)

    false_xy_px = _random_places(rng, conditions.false_stars, (width, height))
    false_e = (star_electrons_per_s(camera, rng.uniform(2.5, 5.0, conditions.false_stars)) * exposure_s
               * _transmission_at(camera, false_xy_px))
    light_e = render_sources(camera.aberrations, np.concatenate([xy_px, false_xy_px]), np.concatenate([flux_e, false_e]),
                             (width, height))
    light_e += sky_electrons_per_s(camera, conditions.sky_mag_arcsec2) * exposure_s * camera.transmission
    cosmic_xy_px = _random_places(rng, conditions.cosmic_hits, (width, height))
    for xy in cosmic_xy_px:
        _add_track(light_e, xy, rng)
    return StarField(light_e=light_e, star_rows=rows, xy_px=xy_px, chief_ray_px=chief_ray_px(camera.aberrations, xy_px),
                     flux_e=flux_e, false_xy_px=false_xy_px, cosmic_xy_px=cosmic_xy_px)


def _on_image(xy_px: np.ndarray, image_size_px: tuple[int, int]) -> np.ndarray:
    """Which places fall on a pixel; NaN does not."""
    return ((xy_px > -0.5) & (xy_px < np.array(image_size_px) - 0.5)).all(axis=1)


def _transmission_at(camera: SimulatedCamera, xy_px: np.ndarray) -> np.ndarray:
    columns, rows = np.rint(xy_px).astype(int).T
    return camera.transmission[rows, columns]


def _random_places(rng: np.random.Generator, count: int, image_size_px: tuple[int, int]) -> np.ndarray:
    return rng.uniform(-0.49, np.array(image_size_px) - 0.51, (count, 2))


def _add_track(light_e: np.ndarray, xy_px: np.ndarray, rng: np.random.Generator) -> None:
    """Charge of one particle along a straight path of up to 6 px."""
    angle, length_px, charge_e = rng.uniform(0, 2 * np.pi), rng.uniform(0, 6), rng.uniform(300, 4000)
    along = np.linspace(0, length_px, 25)[:, None] * [np.cos(angle), np.sin(angle)]
    path = np.rint(xy_px + along).astype(int)
    path = path[_on_image(path, light_e.shape[::-1])]
    np.add.at(light_e, (path[:, 1], path[:, 0]), charge_e / 25)
