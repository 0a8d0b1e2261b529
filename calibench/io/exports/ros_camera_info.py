"""ROS camera_info YAML (camera_calibration_parsers): plumb_bob up to five coefficients, rational_polynomial for eight.

ROS takes its lens models, coefficient order and pixel convention from OpenCV, so the numbers pass unchanged (REP 104).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...records import CalibrationMap
from .. import atomic
from ._lens import measured_lens, named_model, number_list, remarks

MODELS = {"pinhole": "plumb_bob", "brown4": "plumb_bob", "brown5": "plumb_bob", "rational8": "rational_polynomial"}


def export(calmap: CalibrationMap, path: Path | str) -> None:
    """Write the intrinsics as a monocular camera: rectification is the identity, projection the camera matrix.

    Raises:
        BadInput: no exportable intrinsics, a lens model that ROS has not, or the file cannot be written.
    """
    lens = measured_lens(calmap, path)
    model = named_model(lens, MODELS, "ROS", path)
    w, h = lens.image_size_px
    distortion = np.zeros(max(5, len(lens.distortion)))
    distortion[:len(lens.distortion)] = lens.distortion
    # ROS accepts letters, digits and underscores in a camera's name.
    name = re.sub(r"[^A-Za-z0-9_]+", "_", calmap.camera.name).strip("_") or "camera"
    atomic.write_bytes(path, "\n".join((
        *remarks(lens),
        f"image_width: {w}",
        f"image_height: {h}",
        f"camera_name: {name}",
        _matrix("camera_matrix", lens.camera_matrix),
        f"distortion_model: {model}",
        _matrix("distortion_coefficients", distortion[np.newaxis]),
        _matrix("rectification_matrix", np.eye(3)),
        _matrix("projection_matrix", np.column_stack([lens.camera_matrix, np.zeros(3)])),
        "",
    )).encode("ascii"))


def _matrix(name: str, values: np.ndarray) -> str:
    rows, columns = values.shape
    return f"{name}:\n  rows: {rows}\n  cols: {columns}\n  data: [{number_list(values)}]"
