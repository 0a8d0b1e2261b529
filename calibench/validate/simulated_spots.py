"""Spots of a known attitude: the stars that a lens sees, with noise, false spots, missing stars."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..geometry import projection, rotation
from ..records import CalibrationMap, Identification, Intrinsics, Spots
from ..stars.lost_in_space import ready
from ..stars.sky_catalogue import SkyCatalogue

FAINTEST = 6.0
MAGNITUDE_SD = 0.2
WRONG_SIGMA = 6.0


class Condition(NamedTuple):
    """noise_px of each axis; false spots; part of the stars that is missing; most stars, the brightest that are left."""

    noise_px: float = 0.2
    false: int = 0
    missing: float = 0.0
    most: int = 60


CONDITIONS = {
    "clean": Condition(),
    "noise 0.05 px": Condition(noise_px=0.05), "noise 0.5 px": Condition(noise_px=0.5), "noise 1 px": Condition(noise_px=1.0),
    "5 false": Condition(false=5), "20 false": Condition(false=20),
    "20 % missing": Condition(missing=0.2), "50 % missing": Condition(missing=0.5),
    "5 false, 30 % missing": Condition(false=5, missing=0.3),
    "4 stars": Condition(most=4), "6 stars": Condition(most=6), "8 stars": Condition(most=8), "30 stars": Condition(most=30),
}


def variants(calmap: CalibrationMap) -> dict[str, Condition]:
    """The conditions that a trial of methods tries, whatever the map."""
    return CONDITIONS


def bright_sky(sky: SkyCatalogue) -> SkyCatalogue:
    """The sky down to FAINTEST."""
    return SkyCatalogue.seen_by(sky.table.take(sky.table.hp_mag <= FAINTEST), sky.observer)


def look(sky: SkyCatalogue, lens: Intrinsics, condition: Condition, rng: np.random.Generator) -> tuple[np.ndarray, Spots]:
    """A random attitude (3, 3) and the spots that the condition leaves, brightest first; false ones as bright as any star."""
    size = np.array(lens.image_size_px)
    field, turn = ready(lens)[0].view(Spots.none()).field, rng.normal(size=4)
    truth = rotation.matrix_from_quaternion(turn / np.linalg.norm(turn))
    ahead = np.flatnonzero(sky.directions @ (field.centre @ truth) > np.cos(field.half_diagonal))
    xy = projection.project(lens, sky.directions[ahead] @ truth.T)
    on = ((xy > 0) & (xy < size - 1)).all(1) & (rng.random(len(xy)) >= condition.missing)
    magnitude = sky.magnitude[ahead[on]] + rng.normal(0, MAGNITUDE_SD, on.sum())
    brightest = np.argsort(magnitude)[:condition.most]
    xy = np.concatenate([xy[on][brightest] + rng.normal(0, condition.noise_px, (len(brightest), 2)),
                         rng.uniform(0, size - 1, (condition.false, 2))])
    magnitude = np.concatenate([magnitude[brightest], rng.uniform(2, FAINTEST, condition.false)])
    nothing = np.zeros(len(xy))
    covariance = np.tile(np.eye(2) * condition.noise_px**2, (len(xy), 1, 1))
    return truth, Spots(xy_px=xy[np.argsort(magnitude)], covariance_px2=covariance, flux_e=nothing,
                        background_dn=nothing, peak_dn=nothing, pixels=nothing, flags=nothing)


def is_wrong(found: Identification, truth: np.ndarray, noise_px: float) -> bool:
    """Whether half of the stars are not where the truth puts them."""
    there = projection.project(found.intrinsics, found.direction_icrs @ truth.T)
    return not np.median(np.hypot(*(there - found.xy_px).T)) < WRONG_SIGMA * noise_px
