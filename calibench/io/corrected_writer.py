"""A corrected frame as FITS: SIGNAL, VARIANCE and DEFECTS, with the metadata of the frame it came from."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from astropy.io import fits

from ..records import DEFECT_FLAGS, CorrectedFrame, Frame
from . import atomic


def write_corrected(path: Path, corrected: CorrectedFrame, signal_dn: np.ndarray, frame: Frame) -> None:
    """Write atomically, with checksums. signal_dn: as in `corrected`, or with its defects filled.

    Raises:
        BadInput: the disk refuses.
    """
    primary = fits.PrimaryHDU()
    stated = {"EXPTIME": frame.exposure_s, "GAIN": frame.gain_setting, "CCD-TEMP": frame.temperature_c,
              "DATE-OBS": frame.date_obs, "INSTRUME": frame.camera, "BAYERPAT": frame.bayer_pattern, "IMAGETYP": "Light Frame",
              "ROWORDER": "TOP-DOWN", "RAWFILE": frame.name, "RAWSHA": frame.sha256}
    for key, value in stated.items():
        if value is not None:
            primary.header[key] = value
    if np.isfinite(corrected.gain_dn_per_e):
        primary.header["EGAIN"] = (1 / corrected.gain_dn_per_e, "e-/DN")
    images = [fits.ImageHDU(np.asarray(signal_dn, np.float32), name="SIGNAL"),
              fits.ImageHDU(corrected.variance_dn2, name="VARIANCE"), fits.ImageHDU(corrected.defects, name="DEFECTS")]
    images[0].header["BUNIT"] = "DN"
    images[1].header["BUNIT"] = "DN2"
    for name, bit in DEFECT_FLAGS.items():
        images[2].header[f"HIERARCH FLAG {name}"] = bit
    stream = io.BytesIO()
    fits.HDUList([primary, *images]).writeto(stream, checksum=True)
    atomic.write_bytes(path, stream.getvalue())
