"""The figures of flats: gain by photon transfer, and nonuniformity of the response in its three forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...records import Quantity
from .. import _nonuniformity as spatial
from .._dark.below import DarkBelow, MapDark
from .._defects import planes
from .._transfer import TransferPoint, gain
from .levels import FlatLevel

NEED_A_LADDER = tuple(Quantity(name=name, value=None, unit=unit, source="EMVA 1288 release 4", reason=(
    "needs a photon transfer series from dark to saturation, not flats of one level")) for name, unit in (
        ("saturation_e", "e-"), ("dynamic_range_db", "dB"), ("snr_max", "1"), ("linearity_error_percent", "%")))


@dataclass(frozen=True, kw_only=True)
class Level:
    """The flats that the response is read from: mean, temporal variance (None: a single flat), signal above dark, the dark and
    its variance, all (H, W) float32; the mean of each frame; where the dark is from."""

    exposure_s: float | None
    mean_dn: np.ndarray
    variance_dn2: np.ndarray | None
    freedom: int
    levels_dn: np.ndarray
    dark_dn: np.ndarray
    dark_variance_dn2: np.ndarray
    dark_origin: str
    signal_dn: np.ndarray

    @property
    def count(self) -> int:
        return len(self.levels_dn)


def lit(level: FlatLevel, below: DarkBelow | MapDark) -> Level:
    """A level with its images and the dark below it."""
    dark, variance, origin = below.image(level.exposure_s)
    return Level(exposure_s=level.exposure_s, mean_dn=level.mean_image_dn, variance_dn2=level.variance_image_dn2,
                 freedom=level.freedom, levels_dn=level.levels_dn, dark_dn=dark, dark_variance_dn2=variance, dark_origin=origin,
                 signal_dn=level.mean_image_dn - dark)


def gain_quantities(points: list[TransferPoint]) -> tuple[Quantity, Quantity]:
    source = "photon transfer, EMVA 1288 R4 Linear 6.6"
    value = error = None
    reason = "" if points else "needs two flats of a level and the temporal noise of the darks"
    if points:
        value, error, how = gain(points)
        source = f"{source}: {how}"
        if not value > 0:
            reason = f"the variance does not grow with the light ({value:.3g} DN/e-): processed frames?"
            value = error = None
    inverse = 1 / value if value else None
    inverse_error = error * inverse**2 if value else None
    said = {"source": source, "reason": reason}
    return (Quantity(name="gain_dn_per_e", symbol="K", unit="DN/e-", value=value, uncertainty=error, **said),
            Quantity(name="gain_e_per_dn", symbol="1/K", unit="e-/DN", value=inverse, uncertainty=inverse_error, **said))


def prnu(level: Level, bayer_pattern: str | None) -> list[Quantity]:
    """PRNU raw, release 4 and core, in % of the signal; the mean variance over the Bayer planes."""
    out = []
    by_plane = [_by_kind(level, plane) for plane in planes(level.dark_dn.shape, bayer_pattern)] if level.freedom else []
    for kind, text in (spatial.KINDS | {"raw": f"{spatial.KINDS['raw']}: lamp fall-off and dust included"}).items():
        name = f"prnu_{kind}_percent"
        if not level.freedom:
            out.append(Quantity(name=name, value=None, unit="%", symbol="PRNU", source=text,
                                reason="one flat only: temporal noise unknown"))
            continue
        found = spatial.pooled([of_kind[kind] for of_kind in by_plane])
        percent2 = 1e4 * found.signed_variance
        note = "" if percent2 >= 0 else spatial.NEGATIVE.format(percent2, "%^2")
        out.append(Quantity(name=name, value=100 * found.sd, uncertainty=100 * found.uncertainty, unit="%", symbol="PRNU",
                            source=text, reason=note))
    return out


def _by_kind(level: Level, plane: tuple[slice, slice]) -> dict[str, spatial.Spatial]:
    """PRNU of one Bayer plane by kind."""
    bright = spatial.of_each_kind(level.mean_dn[plane], float(np.mean(level.variance_dn2[plane])) / level.count)
    dark = spatial.of_each_kind(level.dark_dn[plane], float(np.mean(level.dark_variance_dn2[plane])))
    signal_dn = float(np.mean(level.signal_dn[plane]))
    return {kind: spatial.difference(bright[kind], dark[kind], signal_dn) for kind in spatial.KINDS}
