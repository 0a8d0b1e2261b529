"""TIFF (revision 6.0, BigTIFF too), read by tifffile. One image a file; compressed ones may need imagecodecs."""

from __future__ import annotations

import dataclasses
import logging
import math
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ..sidecar import Sidecar
from ._exif import exif_of
from ._reading import TRUNCATED_MEND, Reading, Stream, check_claim, decoding, frame_values, luminance

SUFFIXES = (".tif", ".tiff")
REDUCED_IMAGE = 1  # bit of NewSubfileType: a preview of another image of the file
WHITE_IS_ZERO = 0
# tifffile logs what it finds odd; without a handler Python prints that to stderr, beside our one message.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


def read(raw: memoryview, file: Path, sidecar: Sidecar) -> Reading:
    """The one full image of the file, colours as their mean; exposure and ISO from its EXIF directory.

    Raises:
        BadInput: no TIFF, truncated, several images, an inverted scale, or a compression that needs imagecodecs.
    """
    import tifffile

    with decoding(file, "TIFF"), Stream(raw) as stream, tifffile.TiffFile(stream) as tiff:
        pages = [page for page in tiff.pages if not int(page.subfiletype or 0) & REDUCED_IMAGE]
        if not pages:
            raise BadInput("holds no image", file=file, mend=TRUNCATED_MEND)
        if len(pages) > 1:
            raise BadInput(f"holds {len(pages)} images; a frame is one", file=file,
                           mend="save each image as a file of its own")
        page = pages[0]
        _check(page, raw, file)
        try:
            picture = _in_place(page, raw)
            if picture is None:
                picture = page.asarray()
        except ValueError as error:
            if "imagecodecs" not in str(error):
                raise
            raise BadInput(f"its compression ({page.compression.name}) needs the package imagecodecs", file=file,
                           mend="pip install imagecodecs, or save the frame uncompressed") from error
        bits = page.bitspersample
    data, notes = luminance(picture, file=file)
    header, exif_notes = exif_of(raw)
    if isinstance(bits, int) and bits not in (8, 16, 32, 64):
        header = dataclasses.replace(header, bit_depth=bits)
    return Reading(data=frame_values(data, file=file), header=header, notes=(*notes, *exif_notes))


def _in_place(page: object, raw: memoryview) -> np.ndarray | None:
    """The plain pixels of an uncompressed image where they lie in the file; None where they do not lie there as they are.

    The strips of such an image nearly always follow one another, and copying them costs more than reading the file.
    """
    byte_order = page.parent.byteorder
    start, counts = page.dataoffsets[0], page.databytecounts
    together = all(a + n == b for a, n, b in zip(page.dataoffsets, counts, page.dataoffsets[1:], strict=False))
    plain = (page.compression == 1 and page.predictor == 1 and page.fillorder == 1 and not page.is_tiled
             and page.shape == (page.imagelength, page.imagewidth) and page.dtype in ("uint8", "uint16")
             and page.bitspersample == 8 * page.dtype.itemsize)
    if not (plain and together and sum(counts) == page.nbytes):
        return None
    return np.frombuffer(raw, page.dtype.newbyteorder(byte_order), math.prod(page.shape), start).reshape(page.shape)


def _check(page: object, raw: memoryview, file: Path) -> None:
    if page.photometric == WHITE_IS_ZERO:
        raise BadInput("is stored inverted (white is zero)", file=file, mend="save it with black as zero")
    if page.dtype is None:
        raise BadInput(f"stores {page.bitspersample} bits a sample, which has no number type", file=file)
    segments = zip(page.dataoffsets, page.databytecounts, strict=False)
    held = sum(max(0, min(count, len(raw) - offset)) for offset, count in segments)
    compressed = page.compression != 1
    claimed = math.prod(page.shape) * page.bitspersample // 8 if isinstance(page.bitspersample, int) else page.nbytes
    check_claim(page.imagewidth, page.imagelength, file=file, claimed_bytes=claimed, available_bytes=held,
                compressed=compressed)
    missing = sum(page.databytecounts) - held
    if missing > 0:
        raise BadInput(f"{missing} bytes of its image data are missing", file=file, mend=TRUNCATED_MEND)
