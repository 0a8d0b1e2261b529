"""Kalibr's camchain YAML with one camera, cam0, as its wiki documents it ("Yaml formats").

Its radtan is OpenCV's model of four coefficients (k1, k2, p1, p2); pixel (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

from pathlib import Path

from ...records import CalibrationMap
from .. import atomic
from ._lens import measured_lens, named_model, number_list, remarks

MODELS = {"pinhole": "none", "brown4": "radtan"}


def export(calmap: CalibrationMap, path: Path | str) -> None:
    """Write cam0 without `rostopic`, which belongs to a recording and not to the camera.

    Raises:
        BadInput: no exportable intrinsics, a lens model that Kalibr has not, or the file cannot be written.
    """
    lens = measured_lens(calmap, path)
    model = named_model(lens, MODELS, "Kalibr", path)
    w, h = lens.image_size_px
    atomic.write_bytes(path, "\n".join((
        *remarks(lens),
        "cam0:",
        "  camera_model: pinhole",
        f"  intrinsics: [{number_list(lens.parameters[:4])}]",
        f"  distortion_model: {model}",
        f"  distortion_coeffs: [{number_list(lens.distortion)}]",
        f"  resolution: [{w}, {h}]",
        "",
    )).encode("ascii"))
