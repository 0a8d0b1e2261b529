"""FrameMetadata: what one source (a header, a sidecar, a protocol) says about a frame, and how several sources become one.

Sources are never ranked: two that contradict each other are an error that names both, because a wrong exposure or gain
spoils every figure derived from the frame without a sign.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

from ..errors import Contradiction
from ..records import Station
from ..records.frame import utc

BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
# Two sources agree within this: exposures are rounded in headers (1/30 s as 0.0333), temperatures to a tenth.
RELATIVE_TOLERANCE = 1e-3
TEMPERATURE_TOLERANCE_C = 0.05


@dataclass(frozen=True, kw_only=True)
class FrameMetadata:
    """What one source says; None: it does not say. Fields as in `Frame`, plus `alignment` ("left" or "right")."""

    kind: str | None = None
    exposure_s: float | None = None
    gain_setting: float | None = None
    egain_e_per_dn: float | None = None
    temperature_c: float | None = None
    bayer_pattern: str | None = None
    date_obs: str | None = None
    camera: str | None = None
    bit_depth: int | None = None
    black_level_dn: float | None = None
    white_level_dn: float | None = None
    pixel_size_um: float | None = None
    photons_per_px: float | None = None
    focus_um: float | None = None
    chief_rays_px: tuple[tuple[float, float], ...] | None = None
    station: Station | None = None
    alignment: str | None = None


def merge(sources: Sequence[tuple[str, FrameMetadata]], *, file: object) -> FrameMetadata:
    """One FrameMetadata of several named sources, each field from whichever source says it.

    Raises:
        Contradiction: sources contradict each other; every contradiction is listed with both names and values.
    """
    merged: dict[str, object] = {}
    said_by: dict[str, str] = {}
    conflicts = []
    for source, metadata in sources:
        for field in fields(FrameMetadata):
            value = getattr(metadata, field.name)
            if value is None:
                continue
            if field.name not in merged:
                merged[field.name], said_by[field.name] = value, source
            elif not _agree(field.name, merged[field.name], value):
                conflicts.append((field.name, f"{said_by[field.name]} says {merged[field.name]}, {source} says {value}"))
    if conflicts:
        lines = "".join(f"\n  {name}: {what}" for name, what in conflicts)
        raise Contradiction(f"statements about this frame contradict each other:{lines}", file=file,
                            mend="correct or remove the wrong statement; none of them is preferred")
    return FrameMetadata(**merged)


def kind_of(text: str) -> str | None:
    """Frame kind meant by an IMAGETYP or sidecar text, any case; None where the text is not understood.

    A bias is a dark of (nearly) no exposure; a 'dark flat' is a dark taken with a flat's exposure.
    """
    words = text.lower()
    if any(word in words for word in ("dark", "bias", "zero")):
        return "dark"
    if "flat" in words:
        return "flat"
    if any(word in words for word in ("light", "object", "science", "sky", "board")):
        return "light"
    return None


def _agree(name: str, a: object, b: object) -> bool:
    if name == "date_obs":
        return abs((utc(str(a)) - utc(str(b))).total_seconds()) < 1.0
    if isinstance(a, (Station, tuple)):
        return a == b
    if isinstance(a, str):
        return a.strip().lower() == str(b).strip().lower()
    tolerance = TEMPERATURE_TOLERANCE_C if name == "temperature_c" else 0.0
    return math.isclose(a, b, rel_tol=RELATIVE_TOLERANCE, abs_tol=tolerance)
