"""Nouns of the sky wing: Spots, StarTable, Identification, Attitude."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .arrays import frozen, settle
from .intrinsics import Intrinsics

SPOT_FLAGS: dict[str, int] = {"saturated": 1, "edge": 2, "defect": 4, "blend": 8, "trail": 16, "fit_failed": 32, "cosmic": 64}
STATUSES = ("solved", "no_match", "too_few_spots", "rejected")


@dataclass(frozen=True, kw_only=True)
class Spots:
    """Point sources on one frame, brightest first. Raw (distorted) pixels, (x, y).

    xy_px (N, 2); covariance_px2 (N, 2, 2), random part; flux_e (N,) in e- (in DN where the gain is unknown);
    background_dn (N,); peak_dn (N,) above background; pixels (N,) above threshold; flags (N,) of SPOT_FLAGS.
    """

    xy_px: np.ndarray
    covariance_px2: np.ndarray
    flux_e: np.ndarray
    background_dn: np.ndarray
    peak_dn: np.ndarray
    pixels: np.ndarray
    flags: np.ndarray

    def __post_init__(self) -> None:
        n = len(self.xy_px)
        settle(self, xy_px=frozen(self.xy_px, name="Spots.xy_px", shape=(n, 2), dtype=float),
               covariance_px2=frozen(self.covariance_px2, name="Spots.covariance_px2", shape=(n, 2, 2), dtype=float),
               flags=frozen(self.flags, name="Spots.flags", shape=(n,), dtype=np.uint16),
               pixels=frozen(self.pixels, name="Spots.pixels", shape=(n,), dtype=np.int64),
               **{f: frozen(getattr(self, f), name=f"Spots.{f}", shape=(n,), dtype=float)
                  for f in ("flux_e", "background_dn", "peak_dn")})

    @classmethod
    def none(cls) -> Spots:
        """No spots."""
        nothing = np.zeros(0)
        return cls(xy_px=np.zeros((0, 2)), covariance_px2=np.zeros((0, 2, 2)), flux_e=nothing, background_dn=nothing,
                   peak_dn=nothing, pixels=nothing, flags=nothing)

    def __len__(self) -> int:
        return len(self.xy_px)

    def take(self, rows: np.ndarray) -> Spots:
        """The spots of these rows (index or mask), in that order."""
        return Spots(**{f: getattr(self, f)[rows] for f in self.__dataclass_fields__})


@dataclass(frozen=True, kw_only=True)
class StarTable:
    """A star catalogue, ICRS, positions at `epoch_jyear` (Julian year, TDB). NaN / 0 / "" where a field is not known.

    ra_rad, dec_rad; pm_ra_mas_yr (times cos dec), pm_dec_mas_yr; parallax_mas; hp_mag, v_mag, b_v; hip, hr; spectral_type.
    """

    epoch_jyear: float
    hip: np.ndarray
    hr: np.ndarray
    ra_rad: np.ndarray
    dec_rad: np.ndarray
    pm_ra_mas_yr: np.ndarray
    pm_dec_mas_yr: np.ndarray
    parallax_mas: np.ndarray
    hp_mag: np.ndarray
    v_mag: np.ndarray
    b_v: np.ndarray
    spectral_type: np.ndarray
    source: str = ""

    def __post_init__(self) -> None:
        n = len(self.hip)
        for name in self.__dataclass_fields__:
            if name not in ("epoch_jyear", "source"):
                settle(self, **{name: frozen(getattr(self, name), name=f"StarTable.{name}", shape=(n,))})

    def __len__(self) -> int:
        return len(self.hip)

    def take(self, rows: np.ndarray) -> StarTable:
        """The stars of these rows (index or mask), in that order."""
        arrays = {f: getattr(self, f)[rows] for f in self.__dataclass_fields__ if f not in ("epoch_jyear", "source")}
        return StarTable(epoch_jyear=self.epoch_jyear, source=self.source, **arrays)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Which spot is which star. status of STATUSES; `reason` says why a frame was not solved.

    spot_rows, star_rows: (M,) rows of the Spots and the StarTable; xy_px (M, 2) and covariance_px2 (M, 2, 2) of the matched
    spots; direction_icrs (M, 3) unit vectors of the stars as seen (proper motion, aberration applied).
    intrinsics: the lens under which they match (fitted where no map gave one). file: the frame, where the caller names it.
    """

    status: str
    method: str
    reason: str = ""
    spot_rows: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    star_rows: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    xy_px: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    covariance_px2: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    direction_icrs: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    false_match_probability: float = 1.0
    intrinsics: Intrinsics | None = None
    file: str = ""

    def __post_init__(self) -> None:
        m = len(self.spot_rows)
        settle(self, spot_rows=frozen(self.spot_rows, name="Identification.spot_rows", shape=(m,), dtype=int),
               star_rows=frozen(self.star_rows, name="Identification.star_rows", shape=(m,), dtype=int),
               xy_px=frozen(self.xy_px, name="Identification.xy_px", shape=(m, 2), dtype=float),
               covariance_px2=frozen(self.covariance_px2, name="Identification.covariance_px2", shape=(m, 2, 2), dtype=float),
               direction_icrs=frozen(self.direction_icrs, name="Identification.direction_icrs", shape=(m, 3), dtype=float))

    def take(self, rows: np.ndarray) -> Identification:
        """With only these of the matched stars (index or mask), in that order."""
        columns = ("spot_rows", "star_rows", "xy_px", "covariance_px2", "direction_icrs")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})


@dataclass(frozen=True, kw_only=True)
class Attitude:
    """Rotation from ICRS to camera axes: v_cam = R(q_cam_icrs) v_icrs, scalar last, Hamilton.

    covariance_rad2: (3, 3) in camera axes (x right, y down, z boresight), random part: rotation vector d with
    R_true = exp([d]x) R. residual_px: (M, 2) measured minus predicted.
    """

    status: str
    method: str
    q_cam_icrs: np.ndarray
    covariance_rad2: np.ndarray
    residual_px: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    reason: str = ""

    def __post_init__(self) -> None:
        settle(self, q_cam_icrs=frozen(self.q_cam_icrs, name="Attitude.q_cam_icrs", shape=(4,), dtype=float),
               covariance_rad2=frozen(self.covariance_rad2, name="Attitude.covariance_rad2", shape=(3, 3), dtype=float),
               residual_px=frozen(self.residual_px, name="Attitude.residual_px", shape=(None, 2), dtype=float))

    @classmethod
    def unsolved(cls, *, status: str, method: str, reason: str) -> Attitude:
        """No attitude: the identity, with infinite covariance, and the reason."""
        return cls(status=status, method=method, q_cam_icrs=np.array([0.0, 0.0, 0.0, 1.0]),
                   covariance_rad2=np.full((3, 3), np.inf), reason=reason)
