"""Frame: one image with what is known about how it was taken. FrameStack: one pass over many. CorrectedFrame: after the map."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from ..errors import BadInput
from .arrays import frozen, settle
from .station import Station

KINDS = ("dark", "flat", "light", "unknown")


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One image. `light` stands for boards, spots and sky alike.

    data: (H, W), unsigned integers or float32, DN, right-aligned (left-aligned data are shifted by the reader).
    bit_depth: significant bits of the converter; saturation is `white_level_dn`.
    gain_setting: the camera's setting, never e-/DN; egain_e_per_dn: e- per DN where a header states it.
    photons_per_px: mean number of photons that met a pixel in this exposure, where the bench knows its lamp.
    focus_um: reading of the focus stage. chief_rays_px: (N, 2) where the bench's stage puts the chief rays of its spots.
    date_obs: ISO 8601, UTC, start of the exposure. station: place or velocity, air and shutter.
    lossy: the file went through 8-bit or JPEG. range_assumed: no source states the converter's bits; bit_depth and
    white_level_dn are guesses. notes: what the reader had to assume.
    """

    data: np.ndarray
    kind: str = "unknown"
    bit_depth: int
    white_level_dn: float
    black_level_dn: float | None = None
    exposure_s: float | None = None
    gain_setting: float | None = None
    egain_e_per_dn: float | None = None
    temperature_c: float | None = None
    bayer_pattern: str | None = None
    pixel_size_um: float | None = None
    photons_per_px: float | None = None
    focus_um: float | None = None
    chief_rays_px: tuple[tuple[float, float], ...] | None = None
    date_obs: str | None = None
    camera: str | None = None
    station: Station | None = None
    lossy: bool = False
    range_assumed: bool = False
    file: str = ""
    sha256: str = ""
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise BadInput(f"frame kind '{self.kind}' is none of {', '.join(KINDS)}", file=self.file or None)
        settle(self, data=frozen(self.data, name="Frame.data", shape=(None, None)))

    @property
    def image_size_px(self) -> tuple[int, int]:
        return self.data.shape[1], self.data.shape[0]

    @property
    def name(self) -> str:
        """The file's own name, for messages and tables."""
        return self.file.replace("\\", "/").rsplit("/", 1)[-1] or "(frame without a file)"

    @property
    def label(self) -> str:
        """Folder and name of the file: what a map remembers of it (the rest of the path is this machine's business)."""
        return "/".join(self.file.replace("\\", "/").rsplit("/", 2)[-2:])


@dataclass(frozen=True, kw_only=True)
class FrameStack:
    """One pass over `count` frames taken alike: exact integer sums, from which mean and temporal variance follow.

    sum_dn (H, W) int32, sum_sq_dn2 (H, W) uint32 or int64: sums of the data and of their squares.
    """

    sum_dn: np.ndarray
    sum_sq_dn2: np.ndarray
    count: int

    def __post_init__(self) -> None:
        shape = np.shape(self.sum_dn)
        settle(self, **{n: frozen(getattr(self, n), name=f"FrameStack.{n}", shape=shape) for n in ("sum_dn", "sum_sq_dn2")})

    @property
    def mean_dn(self) -> np.ndarray:
        """(H, W) float64, made anew at each call: a stack of a large sensor is kept as its sums alone."""
        return self.sum_dn / self.count

    @property
    def variance_dn2(self) -> np.ndarray:
        """(H, W) float64 with count - 1; NaN where count is 1. Made anew at each call; exactly 0 where nothing changed."""
        n = self.count
        if n == 1:
            return np.full(self.sum_dn.shape, np.nan)
        squares = self.sum_sq_dn2.astype(np.int64)
        squares *= n
        squares -= self.sum_dn.astype(np.int64) ** 2
        return squares / (n * (n - 1))


@dataclass(frozen=True, kw_only=True)
class CorrectedFrame:
    """A frame after the map: offset and dark removed, response divided out.

    signal_dn: (H, W) float32, DN above dark. variance_dn2: (H, W) float32, random part for one pixel of this frame
    (read noise, shot noise where the gain is known); NaN where the read noise is not known. defects: (H, W) DEFECT_FLAGS
    plus saturation. gain_dn_per_e: NaN where unknown.
    """

    signal_dn: np.ndarray
    variance_dn2: np.ndarray
    defects: np.ndarray
    gain_dn_per_e: float
    file: str = ""
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shape = np.shape(self.signal_dn)
        settle(self, **{n: frozen(getattr(self, n), name=f"CorrectedFrame.{n}", shape=shape)
                        for n in ("signal_dn", "variance_dn2", "defects")})


def utc(date_obs: str) -> datetime:
    """The instant of an ISO 8601 text; without an offset it is UTC, as in FITS DATE-OBS.

    Raises:
        ValueError: not an ISO 8601 date.
    """
    instant = datetime.fromisoformat(date_obs)
    return instant.replace(tzinfo=UTC) if instant.tzinfo is None else instant.astimezone(UTC)
