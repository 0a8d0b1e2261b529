"""mrcal's .cameramodel: the text of a Python dictionary. Its OPENCV models keep OpenCV's order of coefficients.

mrcal has the same pixel convention: integer coordinates at the centres of pixels, (0, 0) the top-left one.
"""

from __future__ import annotations

from pathlib import Path

from ...records import CalibrationMap
from .. import atomic
from ._lens import measured_lens, named_model, number_list, remarks

MODELS = {"pinhole": "LENSMODEL_PINHOLE", "brown4": "LENSMODEL_OPENCV4", "brown5": "LENSMODEL_OPENCV5",
          "rational8": "LENSMODEL_OPENCV8"}


def export(calmap: CalibrationMap, path: Path | str) -> None:
    """Write the lens of a camera that stands at the reference (zero extrinsics), without optimization inputs.

    Raises:
        BadInput: no exportable intrinsics, a lens model that mrcal has not, or the file cannot be written.
    """
    lens = measured_lens(calmap, path)
    model = named_model(lens, MODELS, "mrcal", path)
    w, h = lens.image_size_px
    atomic.write_bytes(path, "\n".join((
        *remarks(lens),
        "{",
        f"    'lensmodel':  '{model}',",
        "    # fx, fy, cx, cy, distortion",
        f"    'intrinsics': [ {number_list(lens.parameters)} ],",
        "    # rt_fromref",
        "    'extrinsics': [ 0, 0, 0, 0, 0, 0 ],",
        f"    'imagersize': [ {w}, {h} ],",
        "}",
        "",
    )).encode("ascii"))
