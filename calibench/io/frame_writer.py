"""Write one frame: 16-bit PNG with a sidecar, or FITS with keywords. A file appears whole or not at all."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from ..errors import BadInput, UsageError
from .atomic import write_bytes
from .toml_text import dumps

IMAGETYP = {"dark": "Dark Frame", "flat": "Flat Field", "light": "Light Frame"}
FITS_SUFFIXES = (".fits", ".fit", ".fts")


def write_frame(path: Path, data: np.ndarray, *, kind: str, exposure_s: float, gain_setting: float | None = None,
                temperature_c: float | None = None, egain_e_per_dn: float | None = None, bit_depth: int | None = None,
                black_level_dn: float | None = None, white_level_dn: float | None = None,
                bayer_pattern: str | None = None, pixel_size_um: float | None = None, date_obs: str | None = None,
                camera: str | None = None) -> None:
    """Write data (H, W) uint16, DN, right-aligned, as .png (with `<name>.png.toml` beside it) or .fits.

    What is None is not written. `frames.read_frame` gives all of it back.

    Raises:
        BadInput: data of another shape or type, or the disk refuses. UsageError: an unknown suffix or kind.
    """
    path = Path(path)
    data = np.asarray(data)
    if data.dtype != np.uint16 or data.ndim != 2:
        raise BadInput(f"a frame is written from (H, W) uint16, not {data.shape} {data.dtype}", file=path)
    if kind not in IMAGETYP:
        raise UsageError(f"frame kind '{kind}' is none of {', '.join(IMAGETYP)}")
    said = {"kind": kind, "exposure_s": exposure_s, "gain_setting": gain_setting, "temperature_c": temperature_c,
            "egain_e_per_dn": egain_e_per_dn, "bit_depth": bit_depth, "black_level_dn": black_level_dn,
            "white_level_dn": white_level_dn, "bayer_pattern": bayer_pattern, "pixel_size_um": pixel_size_um,
            "date_obs": date_obs, "camera": camera}
    said = {k: v.item() if isinstance(v, np.generic) else v for k, v in said.items() if v is not None}
    suffix = path.suffix.lower()
    if suffix == ".png":
        # The sidecar goes first: a frame without its metadata would be read as something else.
        write_bytes(path.with_name(path.name + ".toml"), dumps(said).encode())
        write_bytes(path, _png(data))
    elif suffix in FITS_SUFFIXES:
        write_bytes(path, _fits(data, said))
    else:
        raise UsageError(f"frames are written as .png or .fits, not '{path.suffix}'")


def _png(data: np.ndarray) -> bytes:
    import cv2

    return cv2.imencode(".png", data)[1].tobytes()


def _fits(data: np.ndarray, said: dict[str, object]) -> bytes:
    from astropy.io import fits

    keywords = {"kind": "IMAGETYP", "exposure_s": "EXPTIME", "gain_setting": "GAIN", "temperature_c": "CCD-TEMP",
                "egain_e_per_dn": "EGAIN", "bit_depth": "BITDEPTH", "black_level_dn": "BLACKLEV",
                "white_level_dn": "SATURATE", "bayer_pattern": "BAYERPAT", "pixel_size_um": "XPIXSZ",
                "date_obs": "DATE-OBS", "camera": "INSTRUME"}
    header = fits.Header([(keywords[name], IMAGETYP[value] if name == "kind" else value) for name, value in said.items()])
    header["ROWORDER"] = "TOP-DOWN"
    stream = io.BytesIO()
    fits.PrimaryHDU(data, header).writeto(stream, checksum=True)
    return stream.getvalue()
