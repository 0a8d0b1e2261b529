"""What is true of a simulated camera and of its frames, as plain nested dicts that a TOML or JSON file can hold."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..geometry.projection import unproject
from ..geometry.rotation import quaternion_from_matrix
from ..geometry.sphere import position_angle, radec_from_unit, remove_aberration
from ..records import DISTORTION_NAMES, Observer, StarTable
from .board import Board, BoardPose, corner_pixels
from .camera import SimulatedCamera
from .pinholes import PinholeImage
from .starfield import StarField


def camera_truth(camera: SimulatedCamera) -> dict:
    """The camera: identity, intrinsics, sensor figures, lens, PSF, and its defects as pixels [x, y] by class.

    A defect of a dark class carries its dark rate, one of a response class its response, a stuck one its level in DN,
    a telegraph one its step in e-, as third number. Rates and noises: e-/s at the reference temperature and e-.
    """
    intrinsics, sensor, pattern = camera.intrinsics, camera.sensor, camera.pattern
    level = {"hot": pattern.dark_rate_e_per_s, "warm": pattern.dark_rate_e_per_s, "cold": pattern.response,
             "dead": pattern.response, "stuck": pattern.stuck_dn, "telegraph": pattern.telegraph_e}
    names = DISTORTION_NAMES[intrinsics.model]
    return {
        "camera": {"name": camera.name, "pixel_size_um": camera.pixel_size_um, "gain_setting": camera.gain_setting,
                   "image_size_px": list(camera.image_size_px), "seed": camera.seed},
        "intrinsics": {"model": intrinsics.model, "fx_px": intrinsics.fx_px, "fy_px": intrinsics.fy_px,
                       "cx_px": intrinsics.cx_px, "cy_px": intrinsics.cy_px,
                       "distortion": dict(zip(names, intrinsics.distortion.tolist(), strict=True))},
        "sensor": {k: v for k, v in dataclasses.asdict(sensor).items() if k != "defects"}
        | {"temporal_dark_noise_e": sensor.temporal_dark_noise_e, "white_level_dn": sensor.white_level_dn},
        "lens": dataclasses.asdict(camera.lens),
        "psf": {k: list(v) if isinstance(v, tuple) else v for k, v in dataclasses.asdict(camera.aberrations).items()}
        | {"centre": "centre of mass of the light; the chief ray lies coma_px * field inside it"},
        "defects": {name: [[int(x), int(y), round(float(level[name][y, x]), 3)] for x, y in xy]
                    for name, xy in pattern.defect_xy_px.items()},
    }


def board_truth(camera: SimulatedCamera, board: Board, pose: BoardPose) -> dict:
    """Pose (OpenCV's rvec and tvec) and corner pixels, row by row."""
    return {"scene": "board", "columns": board.columns, "rows": board.rows, "square_mm": board.square_mm,
            "rotvec_rad": list(pose.rotvec_rad), "translation_mm": list(pose.translation_mm),
            "corners_xy_px": _rounded(corner_pixels(camera, board, pose))}


def flat_truth(peak_e: float) -> dict:
    """Light where lamp and lens are brightest."""
    return {"scene": "flat", "peak_e": float(peak_e)}


def ladder_truth(photons: float) -> dict:
    """Mean number of photons on each pixel."""
    return {"scene": "ladder", "photons_per_px": float(photons)}


def spots_truth(image: PinholeImage) -> dict:
    """Spots as rows of [chief ray x, y, centroid x, y, flux_e]."""
    rows = np.column_stack([image.chief_ray_px, image.xy_px, image.flux_e])
    return {"scene": "spots", "spots": _rounded(rows)}


def sky_truth(camera: SimulatedCamera, stars: StarTable, field: StarField, r_cam_icrs: np.ndarray,
              observer: Observer) -> dict:
    """Attitude and stars of a sky frame.

    q_cam_icrs: scalar last, of the camera axes, by apparent directions. ra_deg, dec_deg, roll_deg: of the image's
    centre ((W-1)/2, (H-1)/2) through the lens model, aberration removed; roll is the position angle of image up there.
    stars: rows of [chief ray x, y, centroid x, y, flux_e] for the Hipparcos numbers in `hip`, brightest first.
    """
    width, height = camera.image_size_px
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    seen = unproject(camera.intrinsics, np.array([centre, centre - [0.0, 1.0]])) @ r_cam_icrs
    middle, above = remove_aberration(seen, observer.velocity_c)
    ra, dec = radec_from_unit(middle)
    rows = np.column_stack([field.chief_ray_px, field.xy_px, field.flux_e])
    return {"scene": "sky", "q_cam_icrs": quaternion_from_matrix(r_cam_icrs).tolist(),
            "ra_deg": float(np.degrees(ra)), "dec_deg": float(np.degrees(dec)),
            "roll_deg": float(np.degrees(position_angle(middle, above))),
            "hip": np.asarray(stars.hip)[field.star_rows].astype(int).tolist(), "stars": _rounded(rows),
            "false_xy_px": _rounded(field.false_xy_px), "cosmic_xy_px": _rounded(field.cosmic_xy_px)}


def _rounded(array: np.ndarray) -> list:
    """Nested lists to a ten-thousandth of a pixel: truth stays small on disk."""
    return np.round(array, 4).tolist()
