"""solve: frames to attitude. validate: what each layer of a map earns."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import BadInput, UsageError
from .measuring import Frames, Map, MapOut, finish_measurement
from .output import Json, number, print_json, progress, say, table

Identify = Annotated[str, typer.Option(help="Identification method.")]
AttitudeName = Annotated[str, typer.Option("--attitude", help="Attitude method.")]
Detector = Annotated[str, typer.Option(help="Spot detector.")]
Centroid = Annotated[str, typer.Option(help="Centroid method.")]
KSigma = Annotated[float | None, typer.Option(help="Detection threshold in sigma, in place of --false-alarms.", min=1.0)]
FalseAlarms = Annotated[float, typer.Option(help="False spots a frame that noise may give.", min=1e-6)]

HEADER = ("file", "status", "ra deg", "dec deg", "roll deg", "fov deg", "matched", "rms px", "cross \"", "roll \"", "odds")


def solve(frames: Frames, map_: Map = None,
          fov_deg: Annotated[float | None, typer.Option(help="Horizontal field, degrees, to 10 %; without a map.",
                                                        min=0.5, max=120)] = None,
          identify: Identify = "pattern", attitude: AttitudeName = "quest", detector: Detector = "scan",
          centroid: Centroid = "psf_map", k_sigma: KSigma = None, false_alarms: FalseAlarms = 1.0,
          station: Annotated[str | None, typer.Option(help="Place or velocity, air, shutter: a TOML file, or its keys written "
                                                           "out: 'latitude_deg = 48.2; longitude_deg = 16.4'.")] = None,
          track: Annotated[bool, typer.Option("--track", help="Frames follow each other: each from the one before.")] = False,
          catalogue: Annotated[Path | None, typer.Option(help="Star table of this camera, from `catalogue build`.")] = None,
          csv: Annotated[Path | None, typer.Option(help="Also write one line for each frame.")] = None,
          report: Annotated[Path | None, typer.Option(help="Also write an HTML report of the series: sky plot, residual map, "
                                                           "errors by kind.")] = None,
          json_: Json = False) -> None:
    """Where each frame looks: spots, star identification, attitude."""
    import math

    from ..io.csv_table import write_csv
    from ..io.frames import find_frames
    from ..io.map_file import read_map
    from ..io.star_table import SHIPPED, load_star_table
    from ..io.station import read_station
    from ..session.results import CSV_COLUMNS, series_errors_json, solved_json
    from ..session.sky import Sky, solve_files
    from ..session.track import Track
    from ..validate.series_errors import split
    settings = _settings(detector, centroid, attitude, identify, k_sigma, false_alarms)
    calmap = read_map(map_) if map_ else None
    lens_known = calmap is not None and "intrinsics" in calmap.measured
    _check_scale(identify, lens_known or fov_deg is not None)
    paths = find_frames(frames)
    if lens_known and fov_deg is not None:
        say("the map's lens is used; --fov-deg is not needed and was not used")
    solutions = []
    sky, out = Sky(method=identify, table=load_star_table(catalogue or SHIPPED),
                   station=read_station(station) if station else None), []
    with progress() as tell:
        named = frozenset(path for path in paths if path in frames)
        stars, width = sky.table, max(len(path.name) for path in paths)
        if not json_:
            print(_line(HEADER, width))
        for i, solved in enumerate(solve_files(paths, sky, calmap, fov_rad=math.radians(fov_deg) if fov_deg else None,
                                               settings=settings, named=named, solve=Track(sky).solve if track else None)):
            tell("solve", i + 1, len(paths))
            solutions.append(solved.solution)
            out.append(solved_json(solved, calmap, (stars.hip, stars.hp_mag)))
            if not json_:
                _print_frame(out[-1], width)
    errors = series_errors_json(split(solutions))
    if csv:
        write_csv(csv, out, CSV_COLUMNS)
    if report:
        from ..session.series_report import write_series_report
        write_series_report(report, solutions, calmap)
    if json_:
        print_json({"frames": out, "map": str(map_) if map_ else None, "identify": identify, "attitude": attitude,
                    "errors": errors})
    elif errors["frames"] > 1:
        _print_errors(errors)
    raise typer.Exit(0 if all(frame["status"] == "solved" for frame in out) else 1)


def _settings(detector: str, centroid: str, attitude: str, identify: str, k_sigma: float | None,
              false_alarms: float) -> dict:
    """Checked before any frame is read: a mistyped method is a usage error at once."""
    from .. import registry
    for folder, name in (("spots.detect", detector), ("spots.centroid", centroid), ("stars.attitude", attitude),
                         ("stars.identify", identify)):
        registry.load(f"calibench.{folder}", name)
    return {"detector": detector, "centroider": centroid, "attitude_method": attitude, "k_sigma": k_sigma,
            "false_alarms": false_alarms}


def _check_scale(identify: str, scale_known: bool) -> None:
    from .. import registry
    if registry.load("calibench.stars.identify", identify).NEEDS_SCALE and not scale_known:
        raise UsageError(f"identifier '{identify}' works with absolute angles and needs to know the lens",
                         mend="give a map with intrinsics (--map), or about the field (--fov-deg), or --identify pattern")


def _line(parts: tuple[str, ...], width: int) -> str:
    """A frame's line, in columns that are known before the first frame is solved; width: of the longest file name."""
    name, status, *figures = parts
    return f"{name:{width}}  {status:13}" + "".join(f"  {figure:>9}" for figure in figures)


def _print_frame(f: dict, width: int) -> None:
    """One frame, as soon as it is solved."""
    name = Path(f["file"]).name
    print(_line((name, f["status"], number(f["ra_deg"], 8), number(f["dec_deg"], 7), number(f["roll_deg"], 7),
                 number(f["fov_deg"], 5), f"{f['matches']}/{f['spots']}", number(f["residual_rms_px"], 3),
                 number(f["sigma_cross_arcsec"], 3), number(f["sigma_roll_arcsec"], 3),
                 number(f["false_match_probability"], 1)), width), flush=True)
    for note in ([f["reason"]] if f["reason"] else []) + f["warnings"]:
        say(f"{name}: {note}")


def _print_errors(errors: dict) -> None:
    print(f"\nerrors of the series, 1 sigma, from {errors['stars']} stars of {errors['frames']} frames (ECSS-E-ST-60-20C)")
    print(table(("kind", "star px", "cross \"", "roll \"", ""),
                [(kind["name"], number(kind["star_px"], 3), number(kind["cross_arcsec"], 3), number(kind["roll_arcsec"], 3),
                  kind["reason"] or "") for kind in errors["kinds"]]))


def validate(frames: Frames,
             map_: Annotated[Path, typer.Option("--map", help="The calibration map to take apart.")],
             truth: Annotated[Path | None, typer.Option(help="truth.toml of a rendered session; without it the residual of the "
                                                             "matched stars is the measure.")] = None,
             trial: Annotated[str, typer.Option(help="Which trial.")] = "ablation", identify: Identify = "pattern",
             attitude: AttitudeName = "quest", detector: Detector = "scan", centroid: Centroid = "psf_map",
             k_sigma: KSigma = None, false_alarms: FalseAlarms = 1.0,
             report: Annotated[Path | None, typer.Option(help="Also write an HTML report of the trial.")] = None,
             json_: Json = False) -> None:
    """What each layer of a map earns, in arcseconds, on sky frames."""
    from .. import registry
    from ..calmap.conditions import outside_conditions
    from ..io.frames import find_frames, read_frame
    from ..io.map_file import read_map
    from ..session.render import load_truth, sky_truth
    from ..session.results import trial_json
    from ..session.sky import Sky
    from ..validate.case import SkyCase
    settings = _settings(detector, centroid, attitude, identify, k_sigma, false_alarms)
    module = registry.load("calibench.validate.trials", trial)
    calmap, sky = read_map(map_), Sky(method=identify)
    _check_scale(identify, "intrinsics" in calmap.measured)
    tables = load_truth(truth) if truth else {}
    cases = [SkyCase(frame=frame, truth=sky_truth(tables, frame.name))
             for frame in (read_frame(path, "light") for path in find_frames(frames))]
    if truth and any(case.truth is None for case in cases):
        lacking = [case.frame.name for case in cases if case.truth is None]
        raise BadInput(f"no truth is given for {', '.join(lacking)}", file=truth,
                       mend="give the truth.toml that was rendered with them, leave them out, or leave out --truth")
    with progress() as tell:
        count, total = iter(range(1, 10**9)), len(cases) * len(module.variants(calmap))
        found, _ = module.trial(cases, calmap, lambda case: sky.finder(case.frame.date_obs), settings,
                                lambda: tell("solve", next(count), total))
    if report:
        from ..session.series_report import write_trial_report
        write_trial_report(report, found, calmap)
    outside = {case.frame.name: list(said) for case in cases if (said := outside_conditions(case.frame, calmap))}
    if json_:
        print_json(trial_json(found) | {"map": str(map_), "map_outside_conditions": outside})
    else:
        print(table(found.columns, found.rows))
        print(f"\n{found.reading}")
        for name, sentences in outside.items():
            for sentence in sentences:
                say(f"{name}: {sentence}")


def star_lens(frames: Frames, map_: Map = None, map_out: MapOut = None,
              fov_deg: Annotated[float | None, typer.Option(help="Horizontal field, degrees, to 10 %; without a map.",
                                                            min=0.5, max=120)] = None,
              model: Annotated[str | None, typer.Option(help="Lens model; without it, chosen by held-out frames.")] = None,
              json_: Json = False) -> None:
    """Lens from the identified stars of several sky frames."""
    import math

    from ..io.frames import find_frames
    from ..io.map_file import read_map
    from ..records import DISTORTION_NAMES
    from ..session.sky import Sky, solve_files
    from ..session.star_target import star_lens as measure_star_lens
    if model is not None and model not in DISTORTION_NAMES:
        raise UsageError(f"no lens model '{model}'", mend=f"choose one of: {', '.join(DISTORTION_NAMES)}")
    calmap, paths = read_map(map_) if map_ else None, find_frames(frames)
    with progress() as tell:
        solved = []
        for one in solve_files(paths, Sky(), calmap, fov_rad=math.radians(fov_deg) if fov_deg else None,
                               named=frozenset(path for path in paths if path in frames)):
            solved.append(one)
            tell("solve", len(solved), len(paths))
        measurement = measure_star_lens(solved, {"model": model})
    finish_measurement(measurement, [], calmap, map_out, json_)


COMMANDS = (solve, star_lens, validate)
