"""Camera raw (DNG, CR2, NEF, ARW and others), read by LibRaw through rawpy.

The mosaic is taken as the sensor gave it, never developed; exposure and ISO are those LibRaw finds in the file's EXIF.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ..metadata import BAYER_PATTERNS, FrameMetadata
from ..sidecar import Sidecar
from ._reading import Reading, check_claim, decoding

SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")


def read(raw: memoryview, file: Path, sidecar: Sidecar) -> Reading:
    """The visible part of the mosaic, undemosaiced, black level not subtracted; black and white level as the file states.

    Raises:
        BadInput: LibRaw cannot read it, it is truncated, or it holds developed colours instead of a mosaic.
    """
    import rawpy

    with decoding(file, "camera raw"), rawpy.imread(io.BytesIO(raw)) as image:
        sizes = image.sizes
        # Lossless raw coders reach a few to one; a damaged header claims far more.
        check_claim(sizes.raw_width, sizes.raw_height, file=file, claimed_bytes=sizes.raw_width * sizes.raw_height,
                    available_bytes=len(raw), compressed=True)
        if image.raw_type != rawpy.RawType.Flat:
            raise BadInput("holds developed colours, not the sensor's mosaic", file=file,
                           mend="record raw or DNG without demosaicing")
        data = image.raw_image_visible.copy()
        coloured, pattern = image.num_colors > 1, _pattern(image)
        white, blacks, shot = image.white_level, image.black_level_per_channel, image.other
    exposure_s = float(f"{shot.shutter_speed:.7g}")  # LibRaw keeps float32: 1/50 s comes as 0.01999999955
    # Some cameras' white level lies below what their converter can give.
    depth = max(int(white or 0), int(data.max(initial=0))).bit_length()
    notes = []
    if not exposure_s > 0:
        notes.append("no exposure time in the file")
    if len(set(blacks)) > 1:
        notes.append(f"black levels differ by colour ({', '.join(map(str, blacks))} DN): their mean is given")
    if coloured and pattern is None:
        notes.append("its colour filters are no Bayer pattern: none is given")
    header = FrameMetadata(
        exposure_s=exposure_s if exposure_s > 0 else None,
        gain_setting=float(shot.iso_speed) if shot.iso_speed > 0 else None,
        bayer_pattern=pattern, bit_depth=depth or None, alignment="right",
        black_level_dn=float(np.mean(blacks)), white_level_dn=float(white) if white else None)
    return Reading(data=data, header=header, notes=tuple(notes))


def _pattern(image: object) -> str | None:
    """Colours of the first two by two visible pixels, read off pixel by pixel: margins may shift the sensor's pattern."""
    if image.raw_pattern is None or image.raw_pattern.shape != (2, 2):
        return None
    colours, top, left = image.color_desc.decode("ascii"), image.sizes.top_margin, image.sizes.left_margin
    pattern = "".join(colours[image.raw_color(top + row, left + column)] for row in (0, 1) for column in (0, 1))
    return pattern if pattern in BAYER_PATTERNS else None
