"""OpenCV's FileStorage YAML, with the names of its calibration sample, in the layout that OpenCV 4 and 5 both read.

Written by hand: OpenCV 5 writes another YAML version and other tags, and this text is the same wherever it is made.
Conventions agree: OpenCV too has pixel (0, 0) at the centre of the top-left pixel and the same order of coefficients.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ...records import CalibrationMap
from .. import atomic
from ._lens import measured_lens


def export(calmap: CalibrationMap, path: Path | str) -> None:
    """Write camera_matrix (3, 3), distortion_coefficients (1, n), both in OpenCV's order, and the image size in px.

    parameter_uncertainty (1, 4 + n) holds the 1-sigma of fx, fy, cx, cy, distortion. A pinhole has four zero
    coefficients, because a matrix without elements cannot be read back.

    Raises:
        BadInput: no exportable intrinsics, or the file cannot be written.
    """
    lens = measured_lens(calmap, path)
    w, h = lens.image_size_px
    distortion = lens.distortion if len(lens.distortion) else np.zeros(4)
    atomic.write_bytes(path, "\n".join((
        "%YAML:1.0",
        "---",
        f"image_width: {w}",
        f"image_height: {h}",
        _matrix("camera_matrix", lens.camera_matrix),
        _matrix("distortion_coefficients", distortion[np.newaxis]),
        _matrix("parameter_uncertainty", np.sqrt(np.diag(lens.covariance))[np.newaxis]),
        "",
    )).encode("ascii"))


def _matrix(name: str, values: np.ndarray) -> str:
    rows, columns = values.shape
    return (f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n"
            f"   data: [ {', '.join(_numbers(values.ravel()))} ]")


def _numbers(values: Iterable[float]) -> list[str]:
    """The shortest text that reads back as the same double; infinity in YAML's spelling."""
    return [".Inf" if np.isinf(value) else repr(float(value)) for value in values]
