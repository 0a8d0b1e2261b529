"""The simulated sensor: its figures, the fixed pattern that follows from a seed, and one exposure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .camera import SimulatedCamera

# Excess of the dark rate over the median from which a pixel is hot (the class's definition); a warm one has less.
HOT_FROM_E_PER_S = 20.0
_WARM_FROM_E_PER_S = 8.0


@dataclass(frozen=True, kw_only=True)
class Defects:
    """How many pixels of each class a sensor has; hot rates above the 20 e-/s limit are exponential with this scale."""

    hot: int
    hot_scale_e_per_s: float
    warm: int
    cold: int
    dead: int
    stuck: int
    telegraph: int


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """True figures of a sensor. Noises and scatters are 1 sigma.

    Dark rate: lognormal over the pixels with median dark_rate_e_per_s and sigma dark_rate_spread (of its logarithm) at
    dark_reference_c, doubling every dark_doubling_c. dsnu_e: white scatter of the offset; column_dn: scatter of the
    columns' offsets; prnu: scatter of the response. coupling: part of a pixel's charge that shows in each of its four
    neighbours (interpixel capacitance), below 0.25.
    """

    bit_depth: int
    gain_dn_per_e: float
    offset_dn: float
    read_noise_e: float
    reset_noise_e: float
    full_well_e: float
    quantum_efficiency: float
    dark_rate_e_per_s: float
    dark_rate_spread: float
    dark_reference_c: float
    dark_doubling_c: float
    dsnu_e: float
    column_dn: float
    prnu: float
    defects: Defects
    coupling: float = 0.0

    @property
    def white_level_dn(self) -> int:
        return 2**self.bit_depth - 1

    @property
    def temporal_dark_noise_e(self) -> float:
        """Noise of one pixel at zero exposure, quantisation apart."""
        return float(np.hypot(self.read_noise_e, self.reset_noise_e))


@dataclass(frozen=True, kw_only=True)
class FixedPattern:
    """What stays the same from frame to frame, (H, W) each.

    dark_rate_e_per_s at the reference temperature; telegraph_e: step of a pixel that switches between two levels, 0 elsewhere;
    stuck_dn: the level of a stuck pixel, NaN elsewhere. defect_xy_px: class -> (N, 2) integer pixels (x, y).
    """

    offset_dn: np.ndarray
    dark_rate_e_per_s: np.ndarray
    response: np.ndarray
    telegraph_e: np.ndarray
    stuck_dn: np.ndarray
    defect_xy_px: Mapping[str, np.ndarray]


def fixed_pattern(sensor: Sensor, image_size_px: tuple[int, int], rng: np.random.Generator) -> FixedPattern:
    """Draw the fixed pattern of a sensor. Defect classes do not overlap."""
    width, height = image_size_px
    shape = (height, width)
    offset_dn = (sensor.offset_dn + sensor.gain_dn_per_e * sensor.dsnu_e * rng.standard_normal(shape)
                 + sensor.column_dn * rng.standard_normal(width))
    dark_rate = sensor.dark_rate_e_per_s * np.exp(sensor.dark_rate_spread * rng.standard_normal(shape))
    response = 1 + sensor.prnu * rng.standard_normal(shape)
    telegraph_e, stuck_dn = np.zeros(shape), np.full(shape, np.nan)

    d = sensor.defects
    counts = {"hot": d.hot, "warm": d.warm, "cold": d.cold, "dead": d.dead, "stuck": d.stuck, "telegraph": d.telegraph}
    pixels = rng.choice(width * height, sum(counts.values()), replace=False)
    split = np.split(pixels, np.cumsum(list(counts.values()))[:-1])
    place = {name: np.unravel_index(flat, shape) for name, flat in zip(counts, split, strict=True)}
    median = sensor.dark_rate_e_per_s
    dark_rate[place["hot"]] = median + HOT_FROM_E_PER_S + rng.exponential(d.hot_scale_e_per_s, d.hot)
    dark_rate[place["warm"]] = median + rng.uniform(_WARM_FROM_E_PER_S, HOT_FROM_E_PER_S, d.warm)
    response[place["cold"]] = rng.uniform(0.3, 0.7, d.cold)
    response[place["dead"]] = rng.uniform(0.0, 0.05, d.dead)
    telegraph_e[place["telegraph"]] = rng.uniform(80.0, 250.0, d.telegraph)
    # Stuck at full scale, at zero, or somewhere in between.
    levels = np.array([sensor.white_level_dn, 0, *rng.integers(sensor.white_level_dn // 4, sensor.white_level_dn, 2)])
    stuck_dn[place["stuck"]] = rng.choice(levels, d.stuck)
    return FixedPattern(offset_dn=offset_dn, dark_rate_e_per_s=dark_rate, response=response, telegraph_e=telegraph_e,
                        stuck_dn=stuck_dn,
                        defect_xy_px={name: np.column_stack([cols, rows]) for name, (rows, cols) in place.items()})


def expose(camera: SimulatedCamera, light_e: np.ndarray | float, *, exposure_s: float, temperature_c: float,
           rng: np.random.Generator) -> np.ndarray:
    """One frame (H, W) uint16 DN.

    light_e: photo-electrons (H, W) or scalar that a pixel of response 1 collects on average in this exposure, vignetting
    included. Order of events: response, shot noise of light and dark charge, telegraph step (on in half of the frames),
    full well, coupling, read and reset noise, gain, offset, rounding, clipping to the converter's range, stuck pixels.
    """
    sensor, pattern = camera.sensor, camera.pattern
    warming = 2.0 ** ((temperature_c - sensor.dark_reference_c) / sensor.dark_doubling_c)
    charge_e = rng.poisson(light_e * pattern.response.clip(0) + pattern.dark_rate_e_per_s * (warming * exposure_s))
    switching = pattern.telegraph_e > 0
    charge_e = charge_e.astype(float)
    charge_e[switching] += pattern.telegraph_e[switching] * rng.integers(0, 2, np.count_nonzero(switching))
    np.minimum(charge_e, sensor.full_well_e, out=charge_e)
    if sensor.coupling:
        charge_e = _shared(charge_e, sensor.coupling)
    charge_e += sensor.temporal_dark_noise_e * rng.standard_normal(charge_e.shape)
    level_dn = np.rint(sensor.gain_dn_per_e * charge_e + pattern.offset_dn).clip(0, sensor.white_level_dn)
    return np.where(np.isnan(pattern.stuck_dn), level_dn, pattern.stuck_dn).astype(np.uint16)


def _shared(charge_e: np.ndarray, coupling: float) -> np.ndarray:
    """Each pixel's charge seen in part by its four neighbours; at the borders it stays."""
    padded = np.pad(charge_e, 1, mode="edge")
    neighbours = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    return (1 - 4 * coupling) * charge_e + coupling * neighbours
