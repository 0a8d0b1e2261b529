"""Sky frames from disk through the sky wing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from ..calmap.correct import correct, outside_conditions
from ..io.frames import read_frame
from ..io.observer import observer_at
from ..io.star_table import load_star_table
from ..records import CalibrationMap, Frame, Observer, StarTable
from ..stars.lost_in_space import LostInSpace
from ..stars.sky_catalogue import SkyCatalogue
from ..stars.solve import Solution, Solver
from ..validate.trials.ablation import lens_of


@dataclass
class Sky:
    """The star table as seen on each date, each with its identifier; made once a date (stars do not move within a day)."""

    method: str = "pattern"
    table: StarTable = field(default_factory=load_star_table)
    finders: dict[str | None, LostInSpace] = field(default_factory=dict)

    def finder(self, date_obs: str | None) -> LostInSpace:
        """The identifier for frames of that date (ISO 8601, UTC; None: J2000.0, no aberration)."""
        day = date_obs[:10] if date_obs else None
        if day not in self.finders:
            # Aberration changes by 0.35 arcsec a day, so each day has its own sky; noon keeps the error below half of that.
            observer = observer_at(f"{day}T12:00:00") if day else Observer()
            finder = LostInSpace(sky=SkyCatalogue.seen_by(self.table, observer), method=self.method)
            if self.finders:  # rows and sides of the patterns are the same stars' on any date, to far below the tolerance
                finder.tables = next(iter(self.finders.values())).tables
            self.finders[day] = finder
        return self.finders[day]


@dataclass(frozen=True, kw_only=True)
class SolvedFrame:
    """A frame with its solution; outside: the map's conditions that it does not meet."""

    frame: Frame
    solution: Solution
    outside: tuple[str, ...]


def solve_files(paths: Iterable[Path], sky: Sky, calmap: CalibrationMap | None, *, fov_rad: float | None = None,
                settings: dict | None = None) -> Iterator[SolvedFrame]:
    """Read, correct and solve frames one after the other.

    settings: keyword arguments of Solver. fov_rad: horizontal field where the map has no lens.

    Raises:
        BadInput: a frame cannot be read, or has another size than the map.
    """
    familiar: dict = {}
    for path in paths:
        clock = [perf_counter()]
        frame = read_frame(path, "light")
        clock.append(perf_counter())
        layers = calmap or CalibrationMap(image_size_px=frame.image_size_px)
        corrected = correct(frame, layers)
        outside = outside_conditions(frame, layers)
        clock.append(perf_counter())
        solver = Solver(finder=sky.finder(frame.date_obs), familiar=familiar, **(settings or {}))
        solution = solver.solve(corrected, lens_of(layers, fov_rad))
        read, corrected_s = np.diff(clock).tolist()
        timings = {"read": read, "correct": corrected_s} | solution.timings_s
        yield SolvedFrame(frame=frame, solution=replace(solution, timings_s=timings), outside=outside)
