"""What every import shares: a text of bounded size, numbers by a strict spelling, and a lens whose values make sense."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ...records import Intrinsics

MAX_BYTES = 32_000_000  # an mrcal model carries the observations of its calibration; tens of views make some 0.4 MB
MAX_SIDE_PX = 200_000
# No two parts can match the same digits, or a long line of them would be tried in every division.
NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
DAMAGED_MEND = "the file is truncated, damaged or of another format: export it again from the program that made it"


def text_of(path: Path | str) -> str:
    """The text of a file of at most MAX_BYTES.

    Raises:
        BadInput: no such file, too large, or not UTF-8.
    """
    file = Path(path)
    if not file.is_file():
        raise BadInput("there is no such file" if not file.exists() else "this is not a file", file=path,
                       mend="check the path")
    try:
        with open(file, "rb") as handle:
            content = handle.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise BadInput(f"is larger than {MAX_BYTES // 10**6} MB, too much for the file of a lens", file=path,
                           mend=DAMAGED_MEND)
        return content.decode("utf-8")
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror or error}", file=path, mend="check its permissions") from error
    except UnicodeDecodeError as error:
        raise BadInput("is not a text file", file=path, mend=DAMAGED_MEND) from error


def checked_lens(model: str, parameters: Sequence[float], image_size_px: Sequence[float], path: Path | str,
                 covariance: np.ndarray | None = None) -> Intrinsics:
    """Intrinsics of fx, fy, cx, cy, distortion in OpenCV's order; without covariance, it is infinite: unknown.

    Raises:
        BadInput: a number is not finite, a focal length not positive, the size not that of an image, or the covariance
            no covariance.
    """
    values = np.asarray(parameters, float)
    if not np.all(np.isfinite(values)):
        raise BadInput("its intrinsics are not finite", file=path, mend=DAMAGED_MEND)
    if not np.all(values[:2] > 0):
        raise BadInput(f"its focal lengths fx {values[0]:g}, fy {values[1]:g} are not positive", file=path,
                       mend="calibrate again; a mirrored image needs flipped frames, not a negative focal length")
    if not all(1 <= side <= MAX_SIDE_PX and side == int(side) for side in image_size_px):
        raise BadInput(f"its image size {tuple(image_size_px)} is not a whole number of pixels, 1 to {MAX_SIDE_PX}",
                       file=path, mend=DAMAGED_MEND)
    covariance = np.diag(np.full(len(values), np.inf)) if covariance is None else covariance
    if np.isnan(covariance).any() or not np.array_equal(covariance, covariance.T) or np.any(np.diag(covariance) < 0):
        raise BadInput("its parameter_covariance is not symmetric with a diagonal of variances", file=path,
                       mend=DAMAGED_MEND)
    fx, fy, cx, cy = map(float, values[:4])
    return Intrinsics(model=model, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=values[4:],
                      image_size_px=(int(image_size_px[0]), int(image_size_px[1])), covariance=covariance)
