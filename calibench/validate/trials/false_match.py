"""False matches: the probability that an answer states against how often answers are wrong, whatever limit is set for it.

1. Spots of the map's camera with nothing to find (5 to 30 at random), and with part of the truth (4 to 7 stars among 5 to 30
   false spots, as bright): the first can only be answered wrongly, the second is where a wrong answer is nearest.
2. The identifier is asked with every limit of LIMITS in turn: it answers with the first candidate below. Honest odds are
   wrong no oftener than the limit.

With nothing to find one search serves all limits: an answer at one limit is an answer at every larger one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...records import CalibrationMap, Intrinsics
from ...stars.lost_in_space import LostInSpace
from ..case import SkyCase, Trial, the_lens
from ..simulated_spots import Condition, bright_sky, is_wrong, look

SETS = 400  # of spots, of either kind
LIMITS = tuple(10.0**-k for k in range(1, 10))
COLUMNS = ("spots", "limit", "sets", "solved", "wrong", "wrong_rate")
NOTHING, PART = "nothing to find", "part of the truth"


def variants(calmap: CalibrationMap) -> dict[str, Callable]:
    """The kinds of spots that are tried."""
    return {NOTHING: of_nothing, PART: of_part}


def of_nothing(finder: LostInSpace, lens: Intrinsics, rng: np.random.Generator) -> np.ndarray:
    """(limits, 2): whether one set of random spots is solved, and wrongly, at each limit."""
    _, spots = look(finder.sky, lens, Condition(most=0, false=int(rng.integers(5, 31))), rng)
    found = replace(finder, accept=min(LIMITS)).identify(spots, lens.image_size_px, lens=lens)
    return np.repeat(found.false_match_probability < np.array(LIMITS), 2).reshape(-1, 2)


def of_part(finder: LostInSpace, lens: Intrinsics, rng: np.random.Generator) -> np.ndarray:
    """(limits, 2): whether a few stars among false spots are solved, and wrongly, at each limit."""
    condition = Condition(most=int(rng.integers(4, 8)), false=int(rng.integers(5, 31)))
    truth, spots = look(finder.sky, lens, condition, rng)
    out = np.zeros((len(LIMITS), 2), bool)
    for row, limit in zip(out, LIMITS, strict=True):
        found = replace(finder, accept=limit).identify(spots, lens.image_size_px, lens=lens)
        solved = found.status == "solved"
        row[:] = solved, solved and is_wrong(found, truth, condition.noise_px)
    return out


def trial(cases: Sequence[SkyCase], calmap: CalibrationMap, finders: Callable[[SkyCase], LostInSpace],
          settings: dict | None = None, tick: Callable[[], None] = lambda: None) -> tuple[Trial, dict]:
    """The table of kinds of spots by limits. cases: their first frame says whose sky and which identifier is taken.

    Raises:
        BadInput: the map has no lens.
    """
    finder, lens, rows = finders(cases[0]), the_lens(calmap, "the count of false matches"), []
    finder = LostInSpace(sky=bright_sky(finder.sky), method=finder.method)
    for name, tried in variants(calmap).items():
        counts = sum(tried(finder, lens, np.random.default_rng([9, seed])).astype(int) for seed in range(SETS))
        rows += [(name, limit, SETS, int(solved), int(wrong), wrong / SETS)
                 for limit, (solved, wrong) in zip(LIMITS, counts, strict=True)]
        tick()
    reading = "sets of simulated spots that are answered, and answered wrongly, at each limit of the false-match probability"
    return Trial(name="false_match", columns=COLUMNS, rows=tuple(rows), reading=reading), {}
