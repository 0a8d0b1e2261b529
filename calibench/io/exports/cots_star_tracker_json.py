"""The camera file of NASA's COTS-Star-Tracker: JSON with a Brown lens of five coefficients, pixels as in OpenCV.

That project's own calibration script saves the matrix of getOptimalNewCameraMatrix, which belongs to undistorted images,
beside the coefficients of the raw ones; angles are then wrong by degrees. Here both come from one fit.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ...records import DISTORTION_NAMES, CalibrationMap
from .. import atomic
from ._lens import CONVENTION, measured_lens, named_model

MODELS = dict.fromkeys(("pinhole", "brown4", "brown5"), "Brown")


def export(calmap: CalibrationMap, path: Path | str) -> None:
    """Write every key that its `read_cam_json` and its examples use.

    JSON has no comments, so uncertainty (1 sigma, null where unknown) and convention are keys that its reader ignores.

    Raises:
        BadInput: no exportable intrinsics, a lens model of more than five coefficients, or the file cannot be written.
    """
    lens = measured_lens(calmap, path)
    model = named_model(lens, MODELS, "COTS-Star-Tracker", path)
    w, h = lens.image_size_px
    coefficients = dict.fromkeys(DISTORTION_NAMES["brown5"], 0.0)
    coefficients |= dict(zip(DISTORTION_NAMES[lens.model], lens.distortion.tolist(), strict=True))
    sd = np.sqrt(np.diag(lens.covariance))
    text = json.dumps({
        "camera_matrix": lens.camera_matrix.tolist(),
        "dist_coefs": [list(coefficients.values())],
        "resolution": [w, h], "ncols": w, "nrows": h,
        "CameraModel": model, **coefficients,
        "fx": lens.fx_px, "fy": lens.fy_px, "up": lens.cx_px, "vp": lens.cy_px, "skew": 0.0,
        "uncertainty": {name: float(value) if np.isfinite(value) else None
                        for name, value in zip(lens.parameter_names, sd, strict=True)},
        "pixel_convention": CONVENTION,
    }, indent=2, allow_nan=False)
    atomic.write_bytes(path, f"{text}\n".encode("ascii"))
