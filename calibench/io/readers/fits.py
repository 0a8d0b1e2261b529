"""FITS 4.0, plain and tile-compressed (RICE and others, section 10), read by astropy.

GAIN is the camera's setting and EGAIN is e-/DN: they are kept apart. Rows are put top first: ROWORDER 'BOTTOM-UP' flips the
image and the Bayer pattern with it; where ROWORDER is absent the rows are taken as stored, and this is said.
"""

from __future__ import annotations

import io
import threading
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ...records.frame import utc
from ..metadata import BAYER_PATTERNS, FrameMetadata, kind_of, merge
from ..sidecar import Sidecar
from ._reading import TRUNCATED_MEND, Reading, check_claim, decoding, frame_values

SUFFIXES = (".fits", ".fit", ".fts", ".fz")
BLOCK_BYTES = 2880
_WARNINGS = threading.Lock()  # Python's warning filters are of the process, and frames are read by several threads
# Keywords in use for one meaning, by field; where a header carries two of them they must agree.
NUMBERS = {
    "exposure_s": ("EXPTIME", "EXPOSURE"), "gain_setting": ("GAIN",), "egain_e_per_dn": ("EGAIN",),
    "temperature_c": ("CCD-TEMP",), "pixel_size_um": ("XPIXSZ",), "bit_depth": ("BITDEPTH",),
    "black_level_dn": ("BLACKLEV",), "white_level_dn": ("SATURATE",),
}
# Drivers write 0 (or the container's 32 bits) where they do not know these.
KNOWN_WITHIN = {"egain_e_per_dn": (1e-9, np.inf), "pixel_size_um": (1e-9, np.inf), "white_level_dn": (1, np.inf),
                "bit_depth": (1, 16)}
TEXTS = {"kind": ("IMAGETYP", "FRAME"), "bayer_pattern": ("BAYERPAT", "COLORTYP"), "date_obs": ("DATE-OBS",),
         "camera": ("INSTRUME",)}


def read(raw: memoryview, file: Path, sidecar: Sidecar) -> Reading:
    """The one image of the file with its keywords, top row first.

    Raises:
        BadInput: no FITS, truncated, a checksum that does not hold, no single image, or keywords that contradict each other.
    """
    from astropy.io import fits
    from astropy.utils.exceptions import AstropyUserWarning

    with decoding(file, "FITS"), _WARNINGS, warnings.catch_warnings():
        # astropy only warns of truncation and bad checksums; odd but legible cards (VerifyWarning) do no harm.
        warnings.simplefilter("error", AstropyUserWarning)
        warnings.simplefilter("ignore", fits.verify.VerifyWarning)
        with fits.open(io.BytesIO(raw), memmap=False, lazy_load_hdus=True, checksum=True) as hdus:
            images = [hdu for hdu in hdus if hdu.is_image and hdu.header.get("NAXIS", 0) >= 2]
            if len(images) != 1:
                raise BadInput(f"holds {len(images) or 'no'} images; a frame is one", file=file,
                               mend="leave it out (a table, a calibration map), or save each image as a file of its own")
            hdu = images[0]
            header = dict(hdus[0].header) | dict(hdu.header)
            _check(hdu, raw, file)
            data = np.squeeze(hdu.data)
    data = frame_values(data, file=file)
    metadata, notes = metadata_of_header(header, file)
    pattern = _shifted(metadata.bayer_pattern, header)
    order = str(header.get("ROWORDER", "")).strip().upper()
    if order == "BOTTOM-UP":
        data, pattern = np.ascontiguousarray(np.flipud(data)), _flipped(pattern, rows=data.shape[0])
        notes = (*notes, "ROWORDER is BOTTOM-UP: rows flipped, top first" + (" (Bayer pattern too)" if pattern else ""))
    elif order not in ("", "TOP-DOWN"):
        raise BadInput(f"ROWORDER is '{order}', neither TOP-DOWN nor BOTTOM-UP", file=file, mend="correct the keyword")
    elif not order:
        notes = (*notes, "no ROWORDER: rows taken as stored, the first row as the top")
    values = {name: getattr(metadata, name) for name in FrameMetadata.__dataclass_fields__} | {"bayer_pattern": pattern}
    return Reading(data=data, header=FrameMetadata(**values), notes=notes)


def metadata_of_header(header: Mapping[str, object], file: object) -> tuple[FrameMetadata, tuple[str, ...]]:
    """What the keywords say, the Bayer pattern as of the first stored pixel; and what could not be understood.

    Raises:
        BadInput: a keyword's value is no number or no Bayer pattern; SeveralProblems: two keywords contradict each other.
    """
    notes: list[str] = []
    by_keyword: dict[str, dict[str, object]] = {}
    for name, keywords in NUMBERS.items():
        for keyword in (k for k in keywords if header.get(k) not in (None, "")):
            number = _number(header[keyword], keyword, file)
            lowest, highest = KNOWN_WITHIN.get(name, (-np.inf, np.inf))
            if lowest <= number <= highest:
                by_keyword.setdefault(keyword, {})[name] = int(number) if name == "bit_depth" else number
            else:
                notes.append(f"{keyword} {number:g} is no possible value and not used")
    for name, keywords in TEXTS.items():
        for keyword in (k for k in keywords if str(header.get(k) or "").strip()):
            value = _text(name, str(header[keyword]).strip(), keyword, header, file)
            if value is None:
                notes.append(f"{keyword} '{header[keyword]}' is not understood and not used")
            else:
                by_keyword.setdefault(keyword, {})[name] = value
    sources = [(f"keyword {keyword}", FrameMetadata(**values)) for keyword, values in by_keyword.items()]
    return merge(sources, file=file), tuple(notes)


def _check(hdu: object, raw: bytes, file: Path) -> None:
    axes = [int(hdu.header[f"NAXIS{i + 1}"]) for i in range(hdu.header["NAXIS"])]
    if any(n != 1 for n in axes[2:]):
        raise BadInput(f"holds an image of {' x '.join(map(str, axes))}; a frame has one plane", file=file,
                       mend="give the raw frame, or save each plane as a file of its own")
    place = hdu.fileinfo()
    held = len(raw) - place["datLoc"]
    compressed = type(hdu).__name__ == "CompImageHDU"
    check_claim(axes[0], axes[1], file=file, claimed_bytes=axes[0] * axes[1] * abs(hdu.header["BITPIX"]) // 8,
                available_bytes=held, compressed=compressed)
    # Some writers leave out the filling of the last block: up to a block may be missing.
    if held <= place["datSpan"] - BLOCK_BYTES:
        raise BadInput(f"{place['datSpan'] - held} bytes of its image data are missing", file=file, mend=TRUNCATED_MEND)


def _number(value: object, keyword: str, file: object) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = np.nan
    if not np.isfinite(number) or isinstance(value, bool):
        raise BadInput(f"keyword {keyword} is '{value}', not a number", file=file, mend="correct the keyword")
    return number


def _text(name: str, value: str, keyword: str, header: Mapping[str, object], file: object) -> str | None:
    if name == "kind":
        return kind_of(value)
    if name == "bayer_pattern":
        pattern = value.upper()
        if keyword == "BAYERPAT" and pattern not in (*BAYER_PATTERNS, "NONE", "MONO"):
            raise BadInput(f"BAYERPAT is '{value}', none of {', '.join(BAYER_PATTERNS)}", file=file,
                           mend="correct the keyword")
        return pattern if pattern in BAYER_PATTERNS else None
    if name == "date_obs":
        zone = str(header.get("TIMESYS") or "UTC").strip().upper()
        try:
            utc(value)
        except ValueError:
            return None
        return value if zone == "UTC" else None
    return value


def _shifted(pattern: str | None, header: Mapping[str, object]) -> str | None:
    """The pattern of the first stored pixel, where XBAYROFF and YBAYROFF say that it starts elsewhere."""
    if pattern is None:
        return None
    x, y = (int(header.get(keyword) or 0) % 2 for keyword in ("XBAYROFF", "YBAYROFF"))
    return "".join(pattern[2 * ((row + y) % 2) + (column + x) % 2] for row in (0, 1) for column in (0, 1))


def _flipped(pattern: str | None, *, rows: int) -> str | None:
    """The pattern of the image upside down: with an even number of rows its two lines change places."""
    if pattern is None or rows % 2:
        return pattern
    return pattern[2:] + pattern[:2]
