"""OpenCV's FileStorage YAML with the names of its calibration sample, as OpenCV 4 and 5 and our export write it.

Only that layout is understood: top-level `name: value` lines, and matrices of rows, cols (5: sizes), dt and data. A YAML
library would follow aliases, with which a file of 300 bytes can fill the memory; here they are just not a number.
Pixel (0, 0) is the centre of the top-left pixel, as here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ...records import DISTORTION_NAMES, Intrinsics
from ..exports.opencv_yaml import MODELS
from ._checked import DAMAGED_MEND, NUMBER, checked_lens, text_of

# A file of another program does not name its model: the number of coefficients does, as for cv2.projectPoints.
MODEL_BY_COUNT = {len(DISTORTION_NAMES[model]): model for model in MODELS}

_NUMBER = re.compile(rf"{NUMBER}|-?\.Inf|\.Nan", re.IGNORECASE)
_MATRIX = re.compile(
    r"!!opencv-(?:nd-)?matrix\s+(?:rows:\s*(\d{1,2})\s+cols:\s*(\d{1,2})|sizes:\s*\[\s*(\d{1,2})(?:,\s*(\d{1,2}))?\s*\])\s+"
    r"dt:\s*[df]\s+data:\s*\[([^][]*)\]")


def read(path: Path | str) -> Intrinsics:
    """The lens; its covariance where the file has our parameter_covariance, else unknown (infinite).

    cv2.calibrateCamera gives 14 coefficients where it was asked for eight: those beyond the model's must be zero.

    Raises:
        BadInput: not such a file, a name is missing or malformed, a fisheye, skew, or more terms than a model here has.
    """
    entries = _entries(text_of(path), path)
    camera_matrix = _matrix(entries, "camera_matrix", path)
    if camera_matrix.shape != (3, 3):
        raise BadInput(f"its camera_matrix is {_size(camera_matrix)}, not 3 x 3", file=path, mend=DAMAGED_MEND)
    (fx, skew, cx), (zero, fy, cy), last = camera_matrix.tolist()
    if (skew, zero, *last) != (0, 0, 0, 0, 1):
        raise BadInput("its camera_matrix is not [fx 0 cx; 0 fy cy; 0 0 1]", file=path,
                       mend="this is all that OpenCV projects with; calibrate without skew")
    if entries.get("fisheye_model", "0") != "0":
        raise BadInput("its lens is OpenCV's fisheye model", file=path, mend="calibrate with the standard model")
    distortion = _matrix(entries, "distortion_coefficients", path).ravel()
    model = _model(entries, distortion, path)
    n = len(DISTORTION_NAMES[model])
    covariance = _matrix(entries, "parameter_covariance", path) if "parameter_covariance" in entries else None
    if covariance is not None and covariance.shape != (4 + n, 4 + n):
        raise BadInput(f"its parameter_covariance is {_size(covariance)}, not {4 + n} x {4 + n}", file=path,
                       mend=DAMAGED_MEND)
    size = [_scalar(entries, name, path) for name in ("image_width", "image_height")]
    return checked_lens(model, [fx, fy, cx, cy, *distortion[:n]], size, path, covariance)


def _entries(text: str, path: Path | str) -> dict[str, str]:
    """The text after each top-level name, with its indented lines."""
    if not text.startswith("%YAML"):
        raise BadInput("does not begin with %YAML, as OpenCV's files do", file=path, mend=DAMAGED_MEND)
    parts = (re.match(r"(\w+):(.*)", part, re.DOTALL) for part in re.split(r"^(?=\S)", text, flags=re.MULTILINE))
    entries: dict[str, str] = {}
    for name, value in (part.groups() for part in parts if part):
        if name in entries:
            raise BadInput(f"gives {name} twice", file=path, mend=DAMAGED_MEND)
        entries[name] = value.strip()
    return entries


def _number(text: str) -> float | None:
    """A number as OpenCV spells it, also .Inf and .Nan; None where it is anything else."""
    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan")) if _NUMBER.fullmatch(text) else None


def _scalar(entries: Mapping[str, str], name: str, path: Path | str) -> float:
    value = _number(_entry(entries, name, path))
    if value is None:
        raise BadInput(f"its {name} is not a number", file=path, mend=DAMAGED_MEND)
    return value


def _matrix(entries: Mapping[str, str], name: str, path: Path | str) -> np.ndarray:
    found = _MATRIX.fullmatch(_entry(entries, name, path))
    if found is None:
        raise BadInput(f"its {name} is not a matrix of at most 99 x 99 numbers", file=path, mend=DAMAGED_MEND)
    rows, columns = (int(found[1]), int(found[2])) if found[1] else (int(found[3]), int(found[4] or 1))
    count = found[5].count(",") + 1
    if count != rows * columns:
        raise BadInput(f"its {name} holds {count} numbers, not {rows} x {columns}", file=path, mend=DAMAGED_MEND)
    values = [_number(word.strip()) for word in found[5].split(",")]
    if None in values:
        raise BadInput(f"its {name} holds what is not a number", file=path, mend=DAMAGED_MEND)
    return np.array(values).reshape(rows, columns)


def _entry(entries: Mapping[str, str], name: str, path: Path | str) -> str:
    if name not in entries:
        raise BadInput(f"has no {name}; it has: {', '.join(list(entries)[:20]) or 'nothing'}", file=path,
                       mend="name the entries as OpenCV's calibration sample does")
    return entries[name]


def _model(entries: Mapping[str, str], distortion: np.ndarray, path: Path | str) -> str:
    stated, count = entries.get("lens_model"), len(distortion)
    used = int(max(np.flatnonzero(distortion), default=-1)) + 1
    if stated in MODELS:
        fits = used <= len(DISTORTION_NAMES[stated]) <= count
    else:
        shorter = [n for n in sorted(MODEL_BY_COUNT) if used <= n <= count]
        fits = stated is None and bool(shorter)
    if not fits:
        raise BadInput(f"its {count} distortion coefficients, {used} without zeros at the end, are not those of "
                       f"{stated or 'a known model'}", file=path,
                       mend=f"calibrate with one of: {', '.join(f'{model} ({n})' for n, model in MODEL_BY_COUNT.items())}")
    return stated or MODEL_BY_COUNT.get(count, MODEL_BY_COUNT[shorter[0]])


def _size(matrix: np.ndarray) -> str:
    return " x ".join(map(str, matrix.shape))
