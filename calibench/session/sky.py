"""Sky frames from disk through the sky wing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

from ..calmap.correct import correction_warnings, outside_conditions
from ..errors import BadInput
from ..io.observer import frame_observer, observer_at
from ..io.star_cache import kept
from ..io.star_table import load_star_table
from ..records import Attitude, CalibrationMap, Frame, Identification, Observer, Spots, StarTable, Station
from ..stars.lost_in_space import LostInSpace
from ..stars.sky_catalogue import SkyCatalogue
from ..stars.solve import STAGES, Solution, Solver
from .reading import read_or_reason

FIELD_OFF = 0.1  # of the field given: a frame so far off is told, also where it was solved
EXPLAINED = 3  # frames of a series that are searched once more, in vain, for a wrong field


@dataclass
class Sky:
    """The star table as seen on each date, each with its identifier; made once a date (stars do not move within a day).

    station: place or velocity, air and shutter of all frames; it goes before what a frame's own sidecar says.
    """

    method: str = "pattern"
    table: StarTable = field(default_factory=load_star_table)
    station: Station | None = None
    finders: dict[str | None, LostInSpace] = field(default_factory=dict)
    solvers: dict[tuple, Solver] = field(default_factory=dict)
    bare: dict[tuple[int, int], CalibrationMap] = field(default_factory=dict)

    def finder(self, date_obs: str | None) -> LostInSpace:
        """The identifier for frames of that date (ISO 8601, UTC; None: J2000.0, no aberration)."""
        day = date_obs[:10] if date_obs else None
        if day not in self.finders:
            # Aberration changes by 0.35 arcsec a day, so each day has its own sky; noon keeps the error below half of that.
            self.finders[day] = self._finder(observer_at(f"{day}T12:00:00") if day else Observer())
        return self.finders[day]

    def _finder(self, observer: Observer) -> LostInSpace:
        finder = LostInSpace(sky=SkyCatalogue.seen_by(self.table, observer), method=self.method, keep=kept, explain=EXPLAINED)
        if self.finders:  # rows and sides of the patterns are the same stars' on any date, to far below the tolerance
            finder.tables = next(iter(self.finders.values())).tables
        return finder

    def finder_of(self, frame: Frame, observer: Observer) -> LostInSpace:
        """The identifier for one frame: of its day, and of its own sky where air bends it (by arcminutes near the horizon)."""
        day = self.finder(frame.date_obs)
        return day if observer.refraction is None else self._finder(observer)

    def observer_of(self, frame: Frame) -> Observer:
        """The observer of one frame, at its own instant."""
        return frame_observer(frame, self.station)

    def solve(self, frame: Frame, calmap: CalibrationMap | None, *, fov_rad: float | None = None, settings: dict | None = None,
              read_s: float = 0.0) -> SolvedFrame:
        """Solve one frame; what its series shares (the sky's level, a lens fitted to it) serves the next.

        Raises:
            BadInput: the frame has another size than the map.
        """
        layers, observer = self.map_for(frame, calmap), self.observer_of(frame)
        solver = self._solver(settings or {}, self.finder_of(frame, observer))
        solution = solver.solve(frame, layers, fov_rad=fov_rad, observer=observer)
        return SolvedFrame(frame=frame, observer=observer, outside=outside_conditions(frame, layers),
                           solution=replace(solution, timings_s={"read": read_s} | solution.timings_s),
                           warnings=correction_warnings(frame, layers) + _other_field(solution, fov_rad))

    def map_for(self, frame: Frame, calmap: CalibrationMap | None) -> CalibrationMap:
        """The map, or one of nothing where there is none: the same for all frames of a size, so that they are a series."""
        if calmap is not None:
            return calmap
        return self.bare.setdefault(frame.image_size_px, CalibrationMap(image_size_px=frame.image_size_px))

    def _solver(self, settings: dict, finder: LostInSpace) -> Solver:
        key = tuple(sorted(settings.items()))
        if key not in self.solvers:
            self.solvers[key] = Solver(finder=finder, **settings)
        self.solvers[key].finder = finder
        return self.solvers[key]


def _other_field(solution: Solution, fov_rad: float | None) -> tuple[str, ...]:
    """What is to be said where a frame was solved though its field is not the one that was given."""
    if fov_rad is None or solution.status != "solved" or abs(solution.fov_rad / fov_rad - 1) < FIELD_OFF:
        return ()
    there, given = math.degrees(solution.fov_rad), math.degrees(fov_rad)
    return (f"the field is {there:.1f} degrees across, {given:.1f} were given",)


def _unread(path: Path, fault: BadInput, method: str) -> SolvedFrame:
    reason = f"cannot be read: {fault.what}"
    solution = Solution(file=str(path), spots=Spots.none(), timings_s=dict.fromkeys(("read", *STAGES), 0.0),
                        identification=Identification(status="rejected", method=method, reason=reason),
                        attitude=Attitude.unsolved(status="rejected", method=method, reason=reason))
    return SolvedFrame(frame=None, solution=solution)


@dataclass(frozen=True, kw_only=True)
class SolvedFrame:
    """A frame (None: it could not be read) with its solution; outside: the map's conditions that it does not meet; warnings:
    what else a user should know. observer: the frame's, whose time_utc is the attitude's time tag."""

    frame: Frame | None
    solution: Solution
    observer: Observer = field(default_factory=Observer)
    outside: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def solve_files(paths: Iterable[Path], sky: Sky, calmap: CalibrationMap | None, *, fov_rad: float | None = None,
                settings: dict | None = None, named: frozenset[Path] | None = None,
                solve: Callable[..., SolvedFrame] | None = None) -> Iterator[SolvedFrame]:
    """Read, correct and solve frames one after the other.

    settings: keyword arguments of Solver. fov_rad: horizontal field where the map has no lens. named: the frames that were
    named outright (default: all); another that cannot be read is given back as rejected, with the reason. solve: in place of
    the sky's own, that of a `Track`.

    Raises:
        BadInput: a named frame cannot be read, a frame's sources contradict each other, or it has another size than the map.
    """
    for path in paths:
        start = perf_counter()
        frame = read_or_reason(path, "light", named=named is None or path in named)
        if isinstance(frame, BadInput):
            yield _unread(path, frame, sky.method)
            continue
        yield (solve or sky.solve)(frame, calmap, fov_rad=fov_rad, settings=settings, read_s=perf_counter() - start)
