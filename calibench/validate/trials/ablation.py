"""Ablation: what each layer of the map earns, in arcseconds, by solving the same frames with the map less that layer.

The error is that of the image's centre against truth. Where no truth is known (the real sky) the residual of the matched
stars against the catalogue stands in for it, and the table says so. A layer earns error(without it) - error(whole map).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...calmap.assemble import LAYER_GROUPS, without_layer
from ...records import CalibrationMap
from ...stars.lost_in_space import LostInSpace
from ...stars.solve import Solution, Solver
from ..case import ARCSEC, SkyCase, Trial, cross_error_rad, roll_error_rad

RAW, WHOLE = "no map", "whole map"
COLUMNS = ("map", "frames", "solved", "wrong", "matches", "residual_px", "error_arcsec", "roll_error_arcsec", "earned_arcsec")
WRONG_RAD = np.radians(0.5)  # a solved frame farther off than this is not inaccurate but wrong


@dataclass(frozen=True, kw_only=True)
class Tried:
    """One variant of the map over all frames: rms figures over its correctly solved frames, NaN where there are none."""

    name: str
    solutions: tuple[Solution, ...]
    wrong: int
    matches: float
    residual_px: float
    residual_arcsec: float
    error_arcsec: float
    roll_error_arcsec: float


def variants(calmap: CalibrationMap) -> dict[str, CalibrationMap]:
    """No map, the whole map, and the map less each group of layers that was measured and reaches a solution."""
    out = {RAW: CalibrationMap(image_size_px=calmap.image_size_px), WHOLE: calmap}
    for group, layers in LAYER_GROUPS.items():
        if calmap.measured.intersection(layers):
            out[f"without {group}"] = without_layer(calmap, group)
    return out


def attempt(name: str, cases: Sequence[SkyCase], calmap: CalibrationMap, finders: Callable[[SkyCase], LostInSpace],
            settings: dict, tick: Callable[[], None]) -> Tried:
    """Solve every case with one variant of the map."""
    solutions, errors, rolls, matches, residual_px, residual_rad, wrong = [], [], [], [], [], [], 0
    solver = None
    for case in cases:
        solver = solver or Solver(finder=finders(case), **settings)
        solver.finder = finders(case)
        solution = solver.solve(case.frame, calmap)
        tick()
        solutions.append(solution)
        if solution.status != "solved":
            continue
        if case.truth is not None:
            error = cross_error_rad(solution, case.truth)
            if error > WRONG_RAD:
                wrong += 1
                continue
            errors.append(error)
            rolls.append(roll_error_rad(solution, case.truth))
        matches.append(len(solution.attitude.residual_px))
        residual_px.append(np.sqrt(np.mean((solution.attitude.residual_px**2).sum(1))))
        residual_rad.append(residual_px[-1] / solution.identification.intrinsics.fx_px)

    def rms(values: list[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")
    return Tried(name=name, solutions=tuple(solutions), wrong=wrong, matches=float(np.mean(matches)) if matches else 0.0,
                 residual_px=rms(residual_px), residual_arcsec=rms(residual_rad) * ARCSEC,
                 error_arcsec=rms(errors) * ARCSEC, roll_error_arcsec=rms(rolls) * ARCSEC)


def trial(cases: Sequence[SkyCase], calmap: CalibrationMap, finders: Callable[[SkyCase], LostInSpace],
          settings: dict | None = None, tick: Callable[[], None] = lambda: None) -> tuple[Trial, dict[str, Tried]]:
    """The ablation table and, for a report, every variant's solutions.

    Args:
        cases: frames of the map's camera. finders: gives the LostInSpace for a case's observer. settings: keyword arguments of
        `Solver` (detector, centroider, attitude_method). tick: called after each frame.

    Raises:
        BadInput: a frame has another size than the map.
    """
    tried = {name: attempt(name, cases, variant, finders, settings or {}, tick) for name, variant in variants(calmap).items()}
    known = all(case.truth is not None for case in cases)

    def figure(one: Tried) -> float:
        return one.error_arcsec if known else one.residual_arcsec
    rows = []
    for name, one in tried.items():
        solved = sum(s.status == "solved" for s in one.solutions)
        earned = None if name == WHOLE else _finite(figure(one) - figure(tried[WHOLE]))
        rows.append((name, len(cases), solved, one.wrong if known else None, one.matches, _finite(one.residual_px),
                     _finite(figure(one)), _finite(one.roll_error_arcsec) if known else None, earned))
    against = "against truth" if known else "residual of the matched stars (no truth is known)"
    reading = f"error of the image's centre, rms over solved frames, {against}; a layer earned what leaving it out costs"
    return Trial(name="ablation", columns=COLUMNS, rows=tuple(rows), reading=reading), tried


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
