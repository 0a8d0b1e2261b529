"""Identifiers: every identifier on the same simulated spots of the map's camera, over noise, false, missing and few stars.

1. Random attitudes of the map's lens; the stars in the image, brightest first with 0.2 mag of error, each off by the noise.
2. A condition takes stars away, keeps the brightest few, or strews false spots, as bright as any, over the image.
3. Each identifier is asked for the same spots. Solved: its answer is believed; wrong: half of its stars stand more than
   WRONG_SIGMA from where the truth puts them. CPU time of this process, tables built before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ... import registry
from ...errors import BadInput
from ...geometry import projection, rotation
from ...records import CalibrationMap, Identification, Spots
from ...stars.lost_in_space import LostInSpace, ready
from ...stars.sky_catalogue import SkyCatalogue
from ..case import SkyCase, Trial

FRAMES = 20  # of each condition
FAINTEST = 6.0
MAGNITUDE_SD = 0.2
WRONG_SIGMA = 6.0
COLUMNS = ("condition", "identifier", "frames", "solved_percent", "wrong", "cpu_ms", "table_mb", "table_s")


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
    """The conditions that are tried."""
    return CONDITIONS


def trial(cases: Sequence[SkyCase], calmap: CalibrationMap, finders: Callable[[SkyCase], LostInSpace],
          settings: dict | None = None, tick: Callable[[], None] = lambda: None) -> tuple[Trial, dict]:
    """The table of conditions by identifiers. cases: their first frame says whose sky is taken.

    Raises:
        BadInput: the map has no lens.
    """
    if "intrinsics" not in calmap.measured:
        raise BadInput("the comparison of identifiers needs the map's lens", mend="measure intrinsics into the map")
    lens, table = calmap.intrinsics, finders(cases[0]).sky.table
    sky = SkyCatalogue.seen_by(table.take(table.hp_mag <= FAINTEST), finders(cases[0]).sky.observer)
    known, tables = ready(lens)[0].view(Spots.none()), {}
    for method in registry.names("calibench.stars.identify"):
        finder, begin = LostInSpace(sky=sky, method=method), time.process_time()
        made = finder.table(finder.module.table_key(known))
        tables[method] = finder, sum(np.asarray(column).nbytes for column in made) / 1e6, time.process_time() - begin
        finder.identify(look(sky, calmap, Condition(), np.random.default_rng(1))[1], lens.image_size_px, lens=lens)  # compiles
    rows = []
    for name, condition in variants(calmap).items():
        frames = [look(sky, calmap, condition, np.random.default_rng([7, seed])) for seed in range(FRAMES)]
        for method, (finder, table_mb, table_s) in tables.items():
            begin = time.process_time()
            found = [finder.identify(spots, lens.image_size_px, lens=lens) for _, spots in frames]
            cpu_ms = 1e3 * (time.process_time() - begin) / FRAMES
            solved = [f.status == "solved" for f in found]
            wrong = sum(s and is_wrong(f, truth, condition.noise_px)
                        for s, f, (truth, _) in zip(solved, found, frames, strict=True))
            rows.append((name, method, FRAMES, 100 * float(np.mean(solved)), int(wrong), cpu_ms, table_mb, table_s))
        tick()
    reading = ("every identifier on the same simulated spots; wrong answers are counted among the solved; "
               "CPU time of one frame, tables built before")
    return Trial(name="identifiers", columns=COLUMNS, rows=tuple(rows), reading=reading), {}


def look(sky: SkyCatalogue, calmap: CalibrationMap, condition: Condition, rng: np.random.Generator) -> tuple[np.ndarray, Spots]:
    """A random attitude (3, 3) and the spots that the condition leaves, brightest first."""
    size, lens = np.array(calmap.image_size_px), calmap.intrinsics
    field, turn = ready(lens)[0].view(Spots.none()).field, rng.normal(size=4)
    truth = rotation.matrix_from_quaternion(turn / np.linalg.norm(turn))
    directions = sky.directions @ truth.T
    ahead = np.flatnonzero(directions @ field.centre > np.cos(field.half_diagonal))
    xy = projection.project(lens, directions[ahead])
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
