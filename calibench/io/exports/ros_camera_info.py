"""ROS camera_info YAML (camera_calibration_parsers): plumb_bob up to five coefficients, rational_polynomial for eight.

ROS takes its lens models, coefficient order and pixel convention from OpenCV, so the numbers pass unchanged.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...records import CalibrationMap
from .. import atomic
from ._lens import measured_lens


def export(calmap: CalibrationMap, path: Path | str) -> None:
    """Write the intrinsics as a monocular camera: rectification is the identity, projection the camera matrix.

    Raises:
        BadInput: no exportable intrinsics, or the file cannot be written.
    """
    lens = measured_lens(calmap, path)
    w, h = lens.image_size_px
    model = "rational_polynomial" if lens.model == "rational8" else "plumb_bob"
    distortion = np.zeros(max(5, len(lens.distortion)))
    distortion[:len(lens.distortion)] = lens.distortion
    projection = np.column_stack([lens.camera_matrix, np.zeros(3)])
    # ROS accepts letters, digits and underscores in a camera's name.
    name = re.sub(r"[^A-Za-z0-9_]+", "_", calmap.camera.name).strip("_") or "camera"
    atomic.write_bytes(path, "\n".join((
        f"image_width: {w}",
        f"image_height: {h}",
        f"camera_name: {name}",
        _matrix("camera_matrix", 3, 3, lens.camera_matrix.ravel()),
        f"distortion_model: {model}",
        _matrix("distortion_coefficients", 1, len(distortion), distortion),
        _matrix("rectification_matrix", 3, 3, np.eye(3).ravel()),
        _matrix("projection_matrix", 3, 4, projection.ravel()),
        "",
    )).encode("ascii"))


def _matrix(name: str, rows: int, columns: int, values: Sequence[float]) -> str:
    return f"{name}:\n  rows: {rows}\n  cols: {columns}\n  data: [{', '.join(repr(float(v)) for v in values)}]"
