"""Writing the map file (layout in map_layout): the same map gives the same bytes."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from astropy.io import fits

from ..errors import BadInput
from ..records import DEFECT_FLAGS, CalibrationMap
from . import atomic
from .map_layout import SCHEMA, UNITS, arrays_of, describe, digest

# Comment of the sum cards; astropy's own would carry the time of writing, and two writes would differ.
SUM_COMMENT = "FITS checksum convention"


def write_map(path: Path | str, calmap: CalibrationMap) -> None:
    """Write the map, replacing an existing file atomically.

    Raises:
        BadInput: an evidence array has a dtype that FITS cannot hold, or the disk refuses; the old file stays.
    """
    atomic.write_bytes(path, encode_map(calmap))


def encode_map(calmap: CalibrationMap) -> bytes:
    """The map file's bytes.

    Raises:
        BadInput: an evidence array has a dtype that FITS cannot hold.
    """
    meta = describe(calmap)
    quantities = [quantity | {"name": key} for key, quantity in meta["quantities"].items()]
    primary = fits.PrimaryHDU(header=_primary_header(meta))
    hdus = fits.HDUList([
        primary,
        _table("METADATA", {"JSON": [json.dumps(meta, ensure_ascii=True, allow_nan=False)]}),
        _table("QUANTITIES", _columns(quantities, ("name", "symbol", "value", "uncertainty", "unit", "source",
                                                   "reason"))),
        _table("VERDICTS", _columns(meta["verdicts"], ("measurement", "quantity", "status", "value", "uncertainty",
                                                       "minimum", "maximum", "unit", "why", "reason"))),
        _table("INPUTS", {"FILE": list(meta["inputs"]), "SHA256": list(meta["inputs"].values())}),
        *(_image(name, array) for name, array in arrays_of(calmap).items()),
    ])
    for hdu in hdus:
        hdu.add_datasum(SUM_COMMENT)
        hdu.add_checksum(SUM_COMMENT, override_datasum=True)
    stream = io.BytesIO()
    hdus.writeto(stream)
    body = stream.getvalue()[len(primary.header.tostring()):]

    def whole() -> bytes:
        return primary.header.tostring().encode("ascii") + body

    primary.header["FILESIZE"] = len(whole())
    primary.header["SHA256"] = digest(whole())
    primary.add_checksum(SUM_COMMENT, override_datasum=True)
    return whole()


def _primary_header(meta: dict) -> fits.Header:
    """Who, when and under which conditions, for anyone who opens the file without calibench."""
    camera, conditions = meta["camera"], meta["conditions"]
    exposure, temperature, date = (conditions[key] or (None, None)
                                   for key in ("exposure_s", "temperature_c", "date_obs"))
    cards = [
        ("CBSCHEMA", SCHEMA, "version of the calibench map layout"),
        ("FILESIZE", 0, "bytes of this file"),
        ("SHA256", "0" * 64, ""),
        ("ORIGIN", "calibench", ""),
        ("SOFTWARE", meta["software"], ""),
        ("DATE", meta["created"], ""),
        ("WIDTH", meta["image_size_px"][0], "[px] width of the frames"),
        ("HEIGHT", meta["image_size_px"][1], "[px] height of the frames"),
        ("INSTRUME", conditions["camera"] or camera["name"], ""),
        ("SERIAL", camera["serial"], ""),
        ("DETECTOR", camera["sensor"], ""),
        ("LENS", camera["lens"], ""),
        ("XPIXSZ", camera["pixel_size_um"], "[um] pixel pitch"),
        ("EXPMIN", exposure[0], "[s] shortest exposure"),
        ("EXPMAX", exposure[1], "[s] longest exposure"),
        ("TEMPMIN", temperature[0], "[deg C] coldest frame"),
        ("TEMPMAX", temperature[1], "[deg C] warmest frame"),
        ("GAIN", conditions["gain_setting"], "setting of the camera, not e-/DN"),
        ("BITDEPTH", conditions["bit_depth"], "bits of the converter"),
        ("DATE-BEG", date[0], "UTC"),
        ("DATE-END", date[1], "UTC"),
        ("PROTOCOL", meta["protocol_sha256"], ""),
    ]
    return fits.Header([(keyword, _ascii(value) if isinstance(value, str) else value, comment)
                        for keyword, value, comment in cards if value not in (None, "")])


def _image(name: str, array: np.ndarray) -> fits.ImageHDU | fits.BinTableHDU:
    """One array as an extension that knows the array's own dtype and shape (KEY, DTYPE, SHAPE).

    Text becomes a one-column table; bool and float16, which FITS lacks, the next wider type; an array without elements
    an extension without data.
    """
    array = np.asarray(array)
    if array.dtype.kind == "U":
        hdu = _table(name, {"TEXT": [_ascii(text) for text in array.ravel().tolist()]})
    elif array.dtype.kind in "biuf" and array.dtype.itemsize <= 8:
        wider = {"bool": np.uint8, "float16": np.float32}.get(array.dtype.name, array.dtype)
        stored = np.atleast_1d(array).astype(wider)
        hdu = fits.ImageHDU(stored if stored.size else None, name=_ascii(name))
    else:
        raise BadInput(f"a map file cannot hold {name}: its dtype is {array.dtype}",
                       mend="hand over numbers of at most 64 bits, bool or text")
    hdu.header["KEY"] = _ascii(name)
    hdu.header["DTYPE"] = array.dtype.str[1:]  # without the byte order: FITS is big-endian, the reader native
    hdu.header["SHAPE"] = ",".join(str(n) for n in array.shape)
    if UNITS.get(name.lower()):
        hdu.header["BUNIT"] = UNITS[name.lower()]
    if name == "DEFECTS":
        for bit, (flag, value) in enumerate(DEFECT_FLAGS.items()):
            hdu.header[f"BIT{bit}"] = (flag, f"value {value}")
    return hdu


def _columns(rows: Sequence[dict], fields: Sequence[str]) -> dict[str, list]:
    return {field.upper(): [row.get(field, "") for row in rows] for field in fields}


def _table(name: str, columns: dict[str, list]) -> fits.BinTableHDU:
    """A binary table of text and of numbers (doubles, NaN for None)."""
    return fits.BinTableHDU.from_columns([_column(key, values) for key, values in columns.items()], name=_ascii(name))


def _column(key: str, values: list) -> fits.Column:
    if any(isinstance(value, str) for value in values) or not values:
        text = [value.encode("ascii", "backslashreplace") for value in values]
        return fits.Column(key, format=f"{max(map(len, text), default=0) or 1}A", array=np.array(text, dtype="S"))
    return fits.Column(key, format="D", array=np.array([np.nan if value is None else value for value in values]))


def _ascii(text: str) -> str:
    """FITS text is printable ASCII: anything else becomes its backslash escape."""
    return text.encode("unicode_escape").decode("ascii")
