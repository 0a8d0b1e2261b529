"""The nouns: frozen dataclasses of checked, read-only arrays with the unit in the name. Records hold no algorithms."""

from .calibration_map import (
    CURVE_LAYERS,
    DEFECT_FLAGS,
    IMAGE_LAYERS,
    LAYERS,
    SCALAR_LAYERS,
    UNUSABLE,
    CalibrationMap,
    Camera,
    Conditions,
)
from .frame import CorrectedFrame, Frame, FrameStack
from .intrinsics import DISTORTION_NAMES, Intrinsics
from .measurement import Limit, Measurement, Provenance, Quantity, Verdict
from .observer import Observer, Refraction, Rolling
from .psf import CENTRE_OF_MASS, HermiteShape, PsfMap
from .sky import SPOT_FLAGS, STATUSES, Attitude, Identification, Spots, StarTable
from .station import Station

__all__ = [
    "CENTRE_OF_MASS", "CURVE_LAYERS", "DEFECT_FLAGS", "DISTORTION_NAMES", "IMAGE_LAYERS", "LAYERS", "SCALAR_LAYERS",
    "SPOT_FLAGS", "STATUSES", "UNUSABLE",
    "Attitude", "CalibrationMap", "Camera", "Conditions", "CorrectedFrame", "Frame", "FrameStack", "HermiteShape",
    "Identification", "Intrinsics", "Limit", "Measurement", "Observer", "Provenance", "PsfMap", "Quantity", "Refraction",
    "Rolling", "Spots", "StarTable", "Station", "Verdict",
]
