"""CalibrationMap: everything known about one camera, layer by layer. An unmeasured layer is its identity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from ..errors import BadInput
from .arrays import frozen, settle
from .intrinsics import Intrinsics
from .measurement import Quantity, Verdict
from .psf import PsfMap

# Defect flags. The first block follows the vocabulary of JWST's dqflags in meaning, packed into 16 bits.
DEFECT_FLAGS: dict[str, int] = {
    "dead": 1, "hot": 2, "warm": 4, "cold": 8, "stuck": 16, "noisy": 32, "telegraph": 64, "nonlinear": 128,
    "cluster": 256, "column": 512, "row": 1024, "unmeasured": 2048, "hot_thesis": 4096, "saturated": 8192,
}
# Flags under which a pixel's value is not used for a star; the others are information.
UNUSABLE = sum(DEFECT_FLAGS[n] for n in ("dead", "hot", "stuck", "noisy", "telegraph", "column", "row", "saturated"))

# Image layers: name -> identity value.
IMAGE_LAYERS: dict[str, float] = {
    "offset_dn": 0.0, "offset_uncertainty_dn": 0.0,
    "dark_rate_dn_per_s": 0.0, "dark_rate_uncertainty_dn_per_s": 0.0,
    "response": 1.0, "response_uncertainty": 0.0,
    "illumination": 1.0,
    "read_noise_dn": 0.0,
}
SCALAR_LAYERS = ("gain_dn_per_e", "saturation_dn", "dark_reference_c", "dark_activation_ev")
# Curve layers, (K, 2) from a value to a value: name -> identity.
CURVE_LAYERS: dict[str, tuple] = {"linearity_dn": ((0.0, 0.0), (1.0, 1.0))}
LAYERS = (*IMAGE_LAYERS, "defects", *SCALAR_LAYERS, *CURVE_LAYERS, "intrinsics", "psf")


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Who the camera is. Empty text: not stated."""

    name: str = ""
    serial: str = ""
    sensor: str = ""
    lens: str = ""
    pixel_size_um: float | None = None


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What the map was measured under, each a (minimum, maximum) or None where no frame said it.

    camera: how the frames themselves name the camera, which need not be the name that people gave it (`Camera.name`).
    """

    exposure_s: tuple[float, float] | None = None
    temperature_c: tuple[float, float] | None = None
    gain_setting: float | None = None
    bit_depth: int | None = None
    date_obs: tuple[str, str] | None = None
    camera: str | None = None


@dataclass(frozen=True, kw_only=True)
class CalibrationMap:
    """The hub's noun. `measured` names the real layers (of LAYERS); all others hold their identity.

    Image layers are (H, W) float32, `defects` (H, W) uint16 of DEFECT_FLAGS. gain_dn_per_e is NaN and saturation_dn infinite
    where not measured. dark_reference_c: temperature of the dark rate (NaN: not stated); dark_activation_ev: activation energy
    by which it follows the temperature (0: not measured, the rate stays). linearity_dn: (K, 2) ascending, signal above the
    offset and what a linear camera would give. `evidence` carries what a re-analysis needs
    (corner observations), `inputs` the frames' sha256 by "measurement/file".
    Uncertainties here are systematic: common to all frames corrected with this map.
    """

    image_size_px: tuple[int, int]
    measured: frozenset[str] = frozenset()
    offset_dn: np.ndarray = None
    offset_uncertainty_dn: np.ndarray = None
    dark_rate_dn_per_s: np.ndarray = None
    dark_rate_uncertainty_dn_per_s: np.ndarray = None
    response: np.ndarray = None
    response_uncertainty: np.ndarray = None
    illumination: np.ndarray = None
    read_noise_dn: np.ndarray = None
    defects: np.ndarray = None
    gain_dn_per_e: float = np.nan
    saturation_dn: float = np.inf
    linearity_dn: np.ndarray = None
    dark_reference_c: float = np.nan
    dark_activation_ev: float = 0.0
    intrinsics: Intrinsics = None
    psf: PsfMap = None
    camera: Camera = field(default_factory=Camera)
    conditions: Conditions = field(default_factory=Conditions)
    quantities: Mapping[str, Quantity] = field(default_factory=dict)
    verdicts: tuple[Verdict, ...] = ()
    warnings: tuple[str, ...] = ()
    evidence: Mapping[str, np.ndarray] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)
    protocol_sha256: str = ""
    software: str = ""
    created: str = ""

    def __post_init__(self) -> None:
        w, h = (int(n) for n in self.image_size_px)
        unknown = self.measured - set(LAYERS)
        if unknown:
            raise BadInput(f"unknown map layers: {', '.join(sorted(unknown))}", mend=f"known layers: {', '.join(LAYERS)}")
        for name, identity in IMAGE_LAYERS.items():
            value = getattr(self, name)
            layer = np.broadcast_to(np.float32(identity), (h, w)) if value is None else value
            settle(self, **{name: frozen(layer, name=f"map layer {name}", shape=(h, w), dtype=np.float32)})
        for name, identity in CURVE_LAYERS.items():
            value = getattr(self, name)
            curve = frozen(identity if value is None else value, name=f"map layer {name}", shape=(None, 2), dtype=float)
            if len(curve) < 2 or not np.all(np.diff(curve, axis=0) > 0):
                raise BadInput(f"map layer {name} does not ascend")
            settle(self, **{name: curve})
        defects = np.broadcast_to(np.uint16(0), (h, w)) if self.defects is None else self.defects
        settle(self,
               image_size_px=(w, h),
               defects=frozen(defects, name="map layer defects", shape=(h, w), dtype=np.uint16),
               intrinsics=self.intrinsics or Intrinsics.pinhole(focal_px=float(w), image_size_px=(w, h)),
               psf=self.psf or PsfMap.unknown((w, h)),
               measured=frozenset(self.measured))
        for name in ("quantities", "evidence", "inputs", "settings"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
