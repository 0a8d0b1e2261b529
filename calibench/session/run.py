"""run: a whole session from folders of frames to map, attitudes, verdicts and report.

1. Check: every shot of the protocol against what lies in its folder; too little of what is not optional stops here.
2. Measure, each with the map made so far: flats first, because their gain turns dark figures into electrons.
3. Assemble the map, judge it by the protocol's limits, write it.
4. Solve the sky frames without and with the map, and take the map apart layer by layer (ablation).
5. Write results.json and report.html.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

from ..calmap.correct import correct, outside_conditions
from ..errors import BadInput
from ..io import atomic
from ..io.frame_series import FrameSeries, Joined
from ..io.map_file import write_map
from ..records import CalibrationMap, Measurement
from ..report.build import build_report
from ..report.story import ShotStory, SkyStory, Story
from ..validate.case import SkyCase
from ..validate.limits import judge
from ..validate.trials import ablation
from .measuring import into_map, measure
from .places import TRUTH_FILE
from .protocol import Protocol
from .render import load_truth, sky_truth
from .results import measurement_json, pointing_json, solved_json, trial_json, verdict_json
from .shots import judge_shot, open_session, read_shot
from .sky import Sky, SolvedFrame
from .star_names import STAR_NAMES
from .star_target import star_lens

FIRST, LAST = ("flat", "transfer", "dark", "intrinsics", "psf"), ("star_lens",)  # what else there is comes between
Tell = Callable[[str, int, int], None]  # (stage, done, total)


@dataclass(frozen=True, kw_only=True)
class SessionResult:
    """Paths of what was written, and the story told in the report."""

    map_path: Path
    results_path: Path
    report_path: Path
    story: Story
    ok: bool


def run_session(session: Path, out: Path, tell: Tell = lambda stage, done, total: None) -> SessionResult:
    """Run the session in folder `session`; write calibration.fits, results.json and report.html into `out`.

    Raises:
        BadInput: no protocol, shots missing, or a measurement that refuses its frames. Nothing is written then.
    """
    protocol, protocol_sha256 = open_session(session)
    seconds = {}
    clock = perf_counter()
    frames, shots = check_session(session, protocol, tell)
    seconds["read and check"] = perf_counter() - clock
    lacking = [s for s in shots if s.status == "fail"]
    if lacking:
        raise BadInput("the session is not complete:" + "".join(
            f"\n  {s.name}: {'; '.join(s.remarks) or 'no frames'}" for s in lacking), file=session,
            mend=f"take what is missing (calibench plan {session})")

    measurements: dict[str, Measurement] = {}
    calmap = None
    wanted = sorted((shot for shot in protocol.shot if shot.measure and frames[shot.name].seen), key=lambda s: _turn(s.measure))
    sky = Sky(method=protocol.solve.identify)
    settings = {"attitude_method": protocol.solve.attitude, "detector": protocol.solve.detector,
                "centroider": protocol.solve.centroid, "k_sigma": protocol.solve.k_sigma,
                "false_alarms": protocol.solve.false_alarms}
    for i, shot in enumerate(wanted):
        tell(f"measure {shot.measure}", i, len(wanted))
        clock = perf_counter()
        given = Joined(*(frames[name] for name in (shot.name, *shot.with_)))
        asked = protocol.measure.get(shot.measure, {})
        if shot.measure == "star_lens":
            measurements[shot.measure] = star_lens([sky.solve(frame, calmap, settings=settings) for frame in given], asked)
        else:
            measurements[shot.measure] = measure(shot.measure, given, calmap, asked)
        calmap = into_map(list(measurements.values()), None, protocol.camera_record, protocol_sha256)
        seconds[f"measure {shot.measure}"] = perf_counter() - clock
    if calmap is None:
        raise BadInput("no shot of the protocol is measured", file=session, mend="give a shot a `measure`")
    verdicts = judge(calmap.quantities, protocol.limits)
    calmap = replace(calmap, verdicts=verdicts)

    clock = perf_counter()
    cases = _sky_cases(session, protocol, frames)
    trial, sky_stories, solved = _solve_sky(cases, calmap, sky, settings, tell) if cases else (None, (), [])
    seconds["sky and ablation"] = perf_counter() - clock

    story = Story(title=protocol.protocol.name, why=protocol.protocol.why, created=calmap.created, software=calmap.software,
                  calmap=calmap, shots=shots, measurements=measurements, verdicts=verdicts, sky=sky_stories,
                  trials={trial.name: trial} if trial else {}, star_names=STAR_NAMES, seconds=seconds)
    ok = all(v.status != "fail" for v in verdicts) and all(s.calibrated.status == "solved" for s in sky_stories)
    tell("write report", 0, 1)
    page = build_report(story)
    atomic.make_folder(out)
    result = SessionResult(map_path=out / "calibration.fits", results_path=out / "results.json",
                           report_path=out / "report.html", story=story, ok=ok)
    write_map(result.map_path, calmap)
    atomic.write_bytes(result.results_path, json.dumps(_results(story, solved, ok), indent=1, allow_nan=False).encode())
    atomic.write_bytes(result.report_path, page.encode())
    tell("write report", 1, 1)
    return result


def check_session(session: Path, protocol: Protocol, tell: Tell) -> tuple[dict[str, FrameSeries], tuple[ShotStory, ...]]:
    """All frames by shot name, and each shot's story."""
    frames, shots = {}, []
    for i, shot in enumerate(protocol.shot):
        tell(f"read {shot.name}", i, len(protocol.shot))
        frames[shot.name] = read_shot(session, shot)
        shots.append(judge_shot(shot, frames[shot.name]))
    return frames, tuple(shots)


def _sky_cases(session: Path, protocol: Protocol, frames: dict[str, FrameSeries]) -> list[SkyCase]:
    """Light frames of the shots that nobody measures: the sky, with truth where the session carries it."""
    truth = load_truth(session / TRUTH_FILE) if (session / TRUTH_FILE).is_file() else {}
    return [SkyCase(frame=frame, truth=sky_truth(truth, frame.name))
            for shot in protocol.shot if shot.measure is None and shot.kind == "light" for frame in frames[shot.name]]


def _turn(measurement: str) -> int:
    """When a measurement is made: those that others build on first, the stars with the map of all others last."""
    if measurement in LAST:
        return len(FIRST) + 1
    return FIRST.index(measurement) if measurement in FIRST else len(FIRST)


def _solve_sky(cases: list[SkyCase], calmap: CalibrationMap, sky: Sky, settings: dict, tell: Tell) -> tuple:
    total = len(cases) * len(ablation.variants(calmap))
    count = iter(range(1, total + 1))
    trial, tried = ablation.trial(cases, calmap, lambda case: sky.finder(case.frame.date_obs), settings,
                                  lambda: tell("solve sky", next(count), total))
    stories, solved = [], []
    for case, raw, calibrated in zip(cases, tried[ablation.RAW].solutions, tried[ablation.WHOLE].solutions, strict=True):
        seen = sky.finder(case.frame.date_obs).sky
        stories.append(SkyStory(name=case.frame.name, signal_dn=correct(case.frame, calmap).signal_dn, raw=raw,
                                calibrated=calibrated, truth=case.truth, catalogue=seen))
        frame = SolvedFrame(frame=case.frame, solution=calibrated, outside=outside_conditions(case.frame, calmap))
        solved.append(solved_json(frame, calmap, (seen.table.hip, seen.table.hp_mag)) | {"raw": pointing_json(raw)})
    return trial, tuple(stories), solved


def _results(story: Story, solved: list[dict], ok: bool) -> dict:
    return {"protocol": story.title, "created": story.created, "software": story.software, "within_limits": ok,
            "shots": [vars(shot) | {"remarks": list(shot.remarks)} for shot in story.shots],
            "measurements": {name: measurement_json(m) for name, m in story.measurements.items()},
            "verdicts": [verdict_json(v) for v in story.verdicts], "frames": solved,
            "ablation": trial_json(story.trials["ablation"]) if story.trials else None,
            "warnings": list(story.calmap.warnings), "seconds": {k: round(v, 3) for k, v in story.seconds.items()}}
