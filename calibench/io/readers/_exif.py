"""EXIF: exposure time, ISO and camera model from the TIFF structure that JPEG embeds and TIFF is (EXIF 2.32, section 4.6).

Only the few tags that calibration needs are read, each within the bytes given; whatever does not fit is not known.
"""

from __future__ import annotations

import struct

from ..metadata import FrameMetadata

MODEL, EXIF_IFD, EXPOSURE_TIME, ISO, DATE_TIME_ORIGINAL = 0x0110, 0x8769, 0x829A, 0x8827, 0x9003
ASCII, SHORT, LONG, RATIONAL = 2, 3, 4, 5
BYTES_OF_TYPE = {ASCII: 1, SHORT: 2, LONG: 4, RATIONAL: 8}
MAX_TAGS = 500


def exif_of(raw: bytes | memoryview) -> tuple[FrameMetadata, tuple[str, ...]]:
    """What the EXIF tags of a TIFF structure say, and notes.

    The ISO setting is the camera's gain setting. DateTimeOriginal is the camera's local time of an unknown zone, so it is
    noted and never used as a date of observation.
    """
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(bytes(raw[:4]))
    if order is None or len(raw) < 8:
        return FrameMetadata(), ()
    tags = _directory(raw, order, struct.unpack_from(f"{order}I", raw, 4)[0])
    exif = _directory(raw, order, tags[EXIF_IFD]) if isinstance(tags.get(EXIF_IFD), int) else {}
    taken, model, iso = exif.get(DATE_TIME_ORIGINAL), tags.get(MODEL), exif.get(ISO)
    notes = (f"taken {taken} by the camera's clock (zone not known, not used as UTC)",) if taken else ()
    return FrameMetadata(exposure_s=exif.get(EXPOSURE_TIME) or None, gain_setting=float(iso) if iso else None,
                         camera=model or None), notes


def _directory(raw: bytes | memoryview, order: str, at: int) -> dict[int, object]:
    """Tag -> text, number or ratio of one image file directory (TIFF 6.0, section 2); the first value of each tag."""
    tags: dict[int, object] = {}
    if at + 2 > len(raw):
        return tags
    count = min(struct.unpack_from(f"{order}H", raw, at)[0], MAX_TAGS)
    for entry in range(at + 2, min(at + 2 + 12 * count, len(raw) - 11), 12):
        tag, kind, values = struct.unpack_from(f"{order}HHI", raw, entry)
        size = BYTES_OF_TYPE.get(kind, 0) * values
        start = entry + 8 if size <= 4 else struct.unpack_from(f"{order}I", raw, entry + 8)[0]
        if size == 0 or start + size > len(raw):
            continue
        if kind == ASCII:
            tags[tag] = bytes(raw[start:start + min(size, 200)]).split(b"\0")[0].decode("ascii", "replace").strip()
        elif kind == RATIONAL:
            above, below = struct.unpack_from(f"{order}II", raw, start)
            tags[tag] = above / below if below else None
        else:
            tags[tag] = struct.unpack_from(f"{order}{'H' if kind == SHORT else 'I'}", raw, start)[0]
    return tags
