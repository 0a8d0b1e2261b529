"""Identifiers: every identifier on the same simulated spots of the map's camera, over noise, false, missing and few stars.

1. Random attitudes of the map's lens; the stars in the image, brightest first with 0.2 mag of error, each off by the noise.
2. A condition takes stars away, keeps the brightest few, or strews false spots, as bright as any, over the image.
3. Each identifier is asked for the same spots. Solved: its answer is believed; wrong: half of its stars stand more than
   WRONG_SIGMA from where the truth puts them (simulated_spots.py). CPU time of this process, tables built before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from ... import registry
from ...records import CalibrationMap, Spots
from ...stars.lost_in_space import LostInSpace, ready
from ..case import SkyCase, Trial, the_lens
from ..simulated_spots import Condition, bright_sky, is_wrong, look, variants

FRAMES = 20  # of each condition
COLUMNS = ("condition", "identifier", "frames", "solved_percent", "wrong", "cpu_ms", "table_mb", "table_s")


def trial(cases: Sequence[SkyCase], calmap: CalibrationMap, finders: Callable[[SkyCase], LostInSpace],
          settings: dict | None = None, tick: Callable[[], None] = lambda: None) -> tuple[Trial, dict]:
    """The table of conditions by identifiers. cases: their first frame says whose sky is taken.

    Raises:
        BadInput: the map has no lens.
    """
    lens, sky = the_lens(calmap, "the comparison of identifiers"), bright_sky(finders(cases[0]).sky)
    known, tables = ready(lens)[0].view(Spots.none()), {}
    for method in registry.names("calibench.stars.identify"):
        finder, begin = LostInSpace(sky=sky, method=method), time.process_time()
        made = finder.table(finder.module.table_key(known))
        tables[method] = finder, sum(np.asarray(column).nbytes for column in made) / 1e6, time.process_time() - begin
        for tried in (Condition(most=0, false=12), Condition()):  # compiles what a long search and a short one need
            finder.identify(look(sky, lens, tried, np.random.default_rng(1))[1], lens.image_size_px, lens=lens)
    rows = []
    for name, condition in variants(calmap).items():
        frames = [look(sky, lens, condition, np.random.default_rng([7, seed])) for seed in range(FRAMES)]
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

