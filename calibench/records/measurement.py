"""Quantity, Measurement, Limit, Verdict: what was measured, with which evidence, and whether it is good enough."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from .intrinsics import Intrinsics
from .psf import PsfMap


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A figure with its 1-sigma uncertainty and where its definition stands.

    value None: not available, `reason` says why. uncertainty None: not estimated (said in `reason`).
    """

    name: str
    value: float | None
    unit: str
    symbol: str = ""
    uncertainty: float | None = None
    source: str = ""
    reason: str = ""

    def as_json(self) -> dict:
        """{value, unit, uncertainty, ...} with null for what is not finite: JSON has no NaN."""
        def finite(x: float | None) -> float | None:
            return float(x) if x is not None and math.isfinite(x) else None
        out = {"value": finite(self.value), "unit": self.unit, "uncertainty": finite(self.uncertainty),
               "symbol": self.symbol, "source": self.source}
        return out | {"reason": self.reason} if self.reason else out


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Which frames (file name -> sha256) and settings a measurement came from."""

    inputs: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)
    conditions: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """The result of one lab measurement.

    maps: layers for the calibration map by their CalibrationMap field name, (H, W) each.
    layers: scalar or small layers by the same rule (gain_dn_per_e, saturation_dn).
    evidence: arrays a plot or a re-analysis needs (corner observations, residuals, curves), named with units.
    """

    name: str
    image_size_px: tuple[int, int]
    quantities: tuple[Quantity, ...] = ()
    maps: Mapping[str, np.ndarray] = field(default_factory=dict)
    layers: Mapping[str, float] = field(default_factory=dict)
    intrinsics: Intrinsics | None = None
    psf: PsfMap | None = None
    evidence: Mapping[str, np.ndarray] = field(default_factory=dict)
    provenance: Provenance = field(default_factory=Provenance)
    warnings: tuple[str, ...] = ()
    frames_used: int = 0
    frames_rejected: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        for name in ("maps", "layers", "evidence"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def quantity(self, name: str) -> Quantity:
        """The quantity of that name.

        Raises:
            KeyError: it was not measured here.
        """
        for quantity in self.quantities:
            if quantity.name == name:
                return quantity
        raise KeyError(name)


@dataclass(frozen=True, kw_only=True)
class Limit:
    """An acceptance limit on a quantity of a measurement, with the reason it was set."""

    measurement: str
    quantity: str
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A limit met by a measured value: status is pass, fail or skipped, with the reason."""

    limit: Limit
    status: str
    value: float | None = None
    uncertainty: float | None = None
    reason: str = ""
