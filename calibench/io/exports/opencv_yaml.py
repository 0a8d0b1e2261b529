"""OpenCV's FileStorage YAML, with the names of its calibration sample, in the layout that OpenCV 4 and 5 both read.

Written by hand: OpenCV 5 writes another YAML version and other tags, and this text is the same wherever it is made.
Conventions agree: OpenCV too has pixel (0, 0) at the centre of the top-left pixel and the same order of coefficients.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...records import CalibrationMap
from .. import atomic
from ._lens import measured_lens, named_model, number_list

# OpenCV does not name these models: the number of coefficients tells them apart.
MODELS = {name: name for name in ("pinhole", "brown4", "brown5", "rational8")}


def export(calmap: CalibrationMap, path: Path | str) -> None:
    """Write camera_matrix (3, 3), distortion_coefficients (1, n), both in OpenCV's order, and the image size in px.

    Beyond OpenCV's own names: lens_model, parameter_uncertainty (1, 4 + n), the 1-sigma of fx, fy, cx, cy, distortion,
    and parameter_covariance (4 + n, 4 + n), so that a lens read back is the same. A pinhole has four zero coefficients
    but a (4, 4) covariance, because a matrix without elements cannot be read back.

    Raises:
        BadInput: no exportable intrinsics, a lens model that OpenCV has not, or the file cannot be written.
    """
    lens = measured_lens(calmap, path)
    model = named_model(lens, MODELS, "OpenCV", path)
    w, h = lens.image_size_px
    distortion = lens.distortion if len(lens.distortion) else np.zeros(4)
    atomic.write_bytes(path, "\n".join((
        "%YAML:1.0",
        "---",
        f"image_width: {w}",
        f"image_height: {h}",
        f"lens_model: {model}",
        _matrix("camera_matrix", lens.camera_matrix),
        _matrix("distortion_coefficients", distortion[np.newaxis]),
        _matrix("parameter_uncertainty", np.sqrt(np.diag(lens.covariance))[np.newaxis]),
        _matrix("parameter_covariance", lens.covariance),
        "",
    )).encode("ascii"))


def _matrix(name: str, values: np.ndarray) -> str:
    rows, columns = values.shape
    return (f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
            f"   data: [ {number_list(values)} ]")
