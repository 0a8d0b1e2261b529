"""Track: the frames of one camera in their order, each from the one before; lost in space only where the track is lost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

from ..calmap.conditions import outside_conditions
from ..calmap.correct import correction_warnings
from ..calmap.windows import like
from ..records import CalibrationMap, Frame
from ..records.frame import utc
from ..stars.solve import Solution, pointing_of
from ..stars.tracking.tracker import Tracker
from .sky import Sky, SolvedFrame

LONGEST_GAP_S = 60.0  # after which a rate says nothing


@dataclass
class Track:
    """What `Sky.solve` does, with a memory. Frames without a date are taken to follow each other evenly."""

    sky: Sky
    _tracker: Tracker | None = None
    _kind: tuple = ()
    _last_s: float = 0.0
    _count: int = 0

    def solve(self, frame: Frame, calmap: CalibrationMap | None, *, fov_rad: float | None = None, settings: dict | None = None,
              read_s: float = 0.0) -> SolvedFrame:
        """Solve one frame by the track, or lost in space where there is none.

        Raises:
            BadInput: the frame has another size than the map.
        """
        layers = self.sky.map_for(frame, calmap)
        self._count += 1
        dated = frame.date_obs is not None
        time_s = utc(frame.date_obs).timestamp() if dated else float(self._count)
        kind = (*like(frame), dated)
        if self._tracker is not None and kind == self._kind and 0 < time_s - self._last_s <= LONGEST_GAP_S:
            tracked = self._follow(frame, layers, time_s, read_s)
            if tracked.solution.status == "solved":
                self._last_s = time_s
                return tracked
        solved = self.sky.solve(frame, calmap, fov_rad=fov_rad, settings=settings, read_s=read_s)
        if solved.solution.status == "solved":
            self._begin(frame, layers, solved, time_s, kind, settings or {})
        return solved

    def _begin(self, frame: Frame, layers: CalibrationMap, solved: SolvedFrame, time_s: float, kind: tuple,
               settings: dict) -> None:
        found = solved.solution.identification
        calibrated = "intrinsics" in layers.measured
        same = self._tracker is not None and kind == self._kind and 0 < time_s - self._last_s <= LONGEST_GAP_S
        if not same:
            finder = self.sky.finder_of(frame, solved.observer)
            chosen = {name: settings[name] for name in ("centroider",) if name in settings}
            self._tracker = Tracker(sky=finder.sky, calmap=layers, lens=found.intrinsics, calibrated=calibrated, **chosen)
        self._tracker.start(solved.solution.attitude.q_cam_icrs, time_s)
        self._kind, self._last_s = kind, time_s

    def _follow(self, frame: Frame, layers: CalibrationMap, time_s: float, read_s: float) -> SolvedFrame:
        observer, start = self.sky.observer_of(frame), perf_counter()
        spots, found, attitude = self._tracker.follow(frame, time_s, observer)
        timings = {"read": read_s, "correct": 0.0, "detect": 0.0, "identify": 0.0, "attitude": perf_counter() - start}
        pointing = pointing_of(found, attitude, observer) if attitude.status == "solved" else {}
        solution = Solution(file=frame.file, spots=spots, identification=replace(found, file=frame.file), attitude=attitude,
                            timings_s=timings, calibrated=self._tracker.calibrated, **pointing)
        return SolvedFrame(frame=frame, observer=observer, solution=solution, outside=outside_conditions(frame, layers),
                           warnings=correction_warnings(frame, layers))
