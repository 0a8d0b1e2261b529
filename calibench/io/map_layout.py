"""The layout of the map file, shared by its writer and its reader, so that both say the same thing in one place.

A map file is a multi-extension FITS file:

    PRIMARY            who, when, under which conditions; CBSCHEMA, FILESIZE, SHA256
    METADATA           one row, one column JSON: everything that is not an array, as `describe` gives it
    QUANTITIES         a row a quantity        \\
    VERDICTS           a row a verdict          | the same as in METADATA, for any FITS table viewer
    INPUTS             a row a frame: sha256   /
    <LAYER>            one image for each measured image layer; DEFECTS is uint16, its bits named by BIT keywords
    LINEARITY_DN       (K, 2), where measured
    INTRINSICS_COVARIANCE, PSF_COEFFICIENTS, PSF_MEASURED_XY_PX, PSF_HERMITE       where measured
    EVIDENCE/<key>     one for each evidence array

Every HDU carries CHECKSUM and DATASUM. These are blind to swapped 16-bit words, so SHA256 covers every byte of the file
but the two cards that depend on it: SHA256 itself and the CHECKSUM of the primary header.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from pathlib import PurePath

import numpy as np

from ..records import (
    CURVE_LAYERS,
    DEFECT_FLAGS,
    DISTORTION_NAMES,
    IMAGE_LAYERS,
    LAYERS,
    SCALAR_LAYERS,
    CalibrationMap,
    Camera,
    Conditions,
    HermiteShape,
    Intrinsics,
    Limit,
    PsfMap,
    Quantity,
    Verdict,
)

SCHEMA = 1
BLOCK, CARD = 2880, 80
TABLES = ("METADATA", "QUANTITIES", "VERDICTS", "INPUTS")
UNITS = {"offset_dn": "DN", "offset_uncertainty_dn": "DN", "dark_rate_dn_per_s": "DN/s",
         "dark_rate_uncertainty_dn_per_s": "DN/s", "response": "", "response_uncertainty": "", "illumination": "",
         "read_noise_dn": "DN", "gain_dn_per_e": "DN/e-", "saturation_dn": "DN", "linearity_dn": "DN",
         "dark_reference_c": "deg C",
         "dark_activation_ev": "eV"}
ARRAY_LAYERS = (*IMAGE_LAYERS, "defects", *CURVE_LAYERS)


def digest(content: bytes) -> str:
    """SHA-256 over a map file without the SHA256 and CHECKSUM cards of its primary header."""
    end = header_end(content)
    cards = (content[at:at + CARD] for at in range(0, end, CARD))
    sha = hashlib.sha256(b"".join(card for card in cards if card[:8] not in (b"SHA256  ", b"CHECKSUM")))
    sha.update(memoryview(content)[end:])
    return sha.hexdigest()


def header_end(content: bytes) -> int:
    """Where the primary header ends: after the END card (0: it has none)."""
    for at in range(0, len(content), CARD):
        if content[at:at + CARD] == b"END".ljust(CARD):
            return at + CARD
    return 0


def arrays_of(calmap: CalibrationMap) -> dict[str, np.ndarray]:
    """Every array that the file of this map holds, by extension name."""
    arrays = {name.upper(): getattr(calmap, name) for name in ARRAY_LAYERS if name in calmap.measured}
    if "intrinsics" in calmap.measured:
        arrays["INTRINSICS_COVARIANCE"] = calmap.intrinsics.covariance
    if "psf" in calmap.measured:
        arrays["PSF_COEFFICIENTS"] = calmap.psf.coefficients
        arrays["PSF_MEASURED_XY_PX"] = calmap.psf.measured_xy_px
        if calmap.psf.hermite is not None:
            arrays["PSF_HERMITE"] = calmap.psf.hermite.coefficients
    return arrays | {f"EVIDENCE/{key}": array for key, array in sorted(calmap.evidence.items())}


def describe(calmap: CalibrationMap) -> dict:
    """Everything about a map but its arrays, as plain JSON values (null for what is not finite)."""
    return _plain({
        "schema": SCHEMA, "software": calmap.software, "created": calmap.created,
        "protocol_sha256": calmap.protocol_sha256, "image_size_px": calmap.image_size_px,
        "camera": dataclasses.asdict(calmap.camera), "conditions": dataclasses.asdict(calmap.conditions),
        "layers": {name: _layer(calmap, name) for name in LAYERS},
        "intrinsics": _intrinsics(calmap.intrinsics) if "intrinsics" in calmap.measured else None,
        "psf": _psf(calmap.psf) if "psf" in calmap.measured else None,
        "quantities": {key: {"name": q.name} | q.as_json() for key, q in calmap.quantities.items()},
        "verdicts": [dataclasses.asdict(v.limit) | {"status": v.status, "value": v.value, "uncertainty": v.uncertainty,
                                                    "reason": v.reason} for v in calmap.verdicts],
        "warnings": calmap.warnings,
        "evidence": {key: {"shape": a.shape, "dtype": a.dtype.str[1:]} for key, a in sorted(calmap.evidence.items())},
        "inputs": calmap.inputs, "settings": calmap.settings,
    })


def rebuild(meta: dict, arrays: Mapping[str, np.ndarray]) -> CalibrationMap:
    """The map of a description and its arrays by extension name: the inverse of `describe` and `arrays_of`.

    Raises:
        KeyError, TypeError, ValueError, BadInput: the description is not one of this schema.
    """
    measured = frozenset(name for name, layer in meta["layers"].items() if layer["measured"])
    size = tuple(meta["image_size_px"])
    layers = {name: arrays[name.upper()] for name in ARRAY_LAYERS if name in measured}
    layers |= {name: float(meta["layers"][name]["value"]) for name in SCALAR_LAYERS if name in measured}
    if "intrinsics" in measured:
        lens = meta["intrinsics"]
        layers["intrinsics"] = Intrinsics(
            **{name: lens[name] for name in ("model", "fx_px", "fy_px", "cx_px", "cy_px", "mirrored")},
            distortion=[lens["distortion"][name] for name in DISTORTION_NAMES[lens["model"]]],
            image_size_px=tuple(lens["image_size_px"]), skew_px=lens.get("skew_px"), covariance=arrays["INTRINSICS_COVARIANCE"])
    if "psf" in measured:
        psf = meta["psf"]
        residual = psf["residual_rms_px2"]
        layers["psf"] = PsfMap(
            **{name: psf[name] for name in ("model", "degree", "centre")}, image_size_px=tuple(psf["image_size_px"]),
            residual_rms_px2=math.inf if residual is None else residual,
            coefficients=arrays["PSF_COEFFICIENTS"], measured_xy_px=arrays["PSF_MEASURED_XY_PX"],
            # maps written before the shape was measured have no such entry
            hermite=HermiteShape(**psf["hermite"], coefficients=arrays["PSF_HERMITE"]) if psf.get("hermite") else None)
    spans = {name: tuple(value) if isinstance(value, list) else value for name, value in meta["conditions"].items()}
    return CalibrationMap(
        image_size_px=size, measured=measured, **layers,
        camera=Camera(**meta["camera"]), conditions=Conditions(**spans),
        quantities={key: Quantity(**quantity) for key, quantity in meta["quantities"].items()},
        verdicts=tuple(_verdict(entry) for entry in meta["verdicts"]), warnings=tuple(meta["warnings"]),
        evidence={key: arrays[f"EVIDENCE/{key}"] for key in meta["evidence"]},
        inputs=meta["inputs"], settings=meta["settings"],
        protocol_sha256=meta["protocol_sha256"], software=meta["software"], created=meta["created"])


def required_extensions(meta: dict) -> list[str]:
    """The extension names that a file with this description must hold."""
    measured = [name for name, layer in meta["layers"].items() if layer["measured"]]
    names = [name.upper() for name in ARRAY_LAYERS if name in measured]
    names += ["INTRINSICS_COVARIANCE"] if "intrinsics" in measured else []
    names += ["PSF_COEFFICIENTS", "PSF_MEASURED_XY_PX"] if "psf" in measured else []
    names += ["PSF_HERMITE"] if "psf" in measured and meta["psf"].get("hermite") else []
    return [*TABLES, *names, *(f"EVIDENCE/{key}" for key in meta["evidence"])]


def _layer(calmap: CalibrationMap, name: str) -> dict:
    if name not in calmap.measured:
        return {"measured": False}
    value = getattr(calmap, name)
    if name in IMAGE_LAYERS:
        return {"measured": True, "unit": UNITS[name], "median": np.median(value), "minimum": value.min(),
                "maximum": value.max()}
    if name in CURVE_LAYERS:
        return {"measured": True, "unit": UNITS[name], "points": len(value), "largest_correction": np.abs(np.diff(value)).max()}
    if name in SCALAR_LAYERS:
        return {"measured": True, "unit": UNITS[name], "value": value}
    if name == "defects":
        counts = {flag: np.count_nonzero(value & bit) for flag, bit in DEFECT_FLAGS.items()}
        return {"measured": True, "counts": counts}
    return {"measured": True}


def _intrinsics(lens: Intrinsics) -> dict:
    sd = np.sqrt(np.diag(lens.covariance))
    return {"model": lens.model, "fx_px": lens.fx_px, "fy_px": lens.fy_px, "cx_px": lens.cx_px, "cy_px": lens.cy_px,
            "skew_px": lens.skew_px,
            "distortion": dict(zip(DISTORTION_NAMES[lens.model], lens.distortion, strict=True)),
            "uncertainty": dict(zip(lens.parameter_names, sd, strict=True)),
            "image_size_px": lens.image_size_px, "mirrored": lens.mirrored}


def _psf(psf: PsfMap) -> dict:
    return {"model": psf.model, "degree": psf.degree, "centre": psf.centre, "image_size_px": psf.image_size_px,
            "residual_rms_px2": psf.residual_rms_px2, "spots": len(psf.measured_xy_px),
            "hermite": None if psf.hermite is None else {field.name: getattr(psf.hermite, field.name)
                                                         for field in dataclasses.fields(psf.hermite)
                                                         if field.name != "coefficients"}}


def _verdict(entry: dict) -> Verdict:
    limit = {field.name: entry[field.name] for field in dataclasses.fields(Limit)}
    return Verdict(limit=Limit(**limit), **{name: value for name, value in entry.items() if name not in limit})


def _plain(value: object) -> object:
    """The same value in JSON's types; an array becomes a list, what is not finite null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    raise TypeError(f"a {type(value).__name__} cannot stand in the metadata of a map")
