"""One command for each measurement: intrinsics, dark, flat, psf."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UsageError
from .output import Json, number, print_json, progress, say, table

if TYPE_CHECKING:  # starting the command line loads no numpy
    from ..records import CalibrationMap, Measurement

Frames = Annotated[list[Path], typer.Argument(metavar="FRAMES...", help="Frame files and folders of frames.")]
Map = Annotated[Path | None, typer.Option("--map", help="A calibration map to use.")]
MapOut = Annotated[Path | None, typer.Option("--map-out", help="Write a map: the new layers on a copy of --map, if given.")]


def intrinsics(frames: Frames,
               board: Annotated[str, typer.Option(help="Inner corners (or dots), columns x rows, like 9x6.")],
               square_mm: Annotated[float, typer.Option(help="Side of one square, mm (dots: their distance; asymmetric dots: "
                                                             "half their distance in a row).")],
               model: Annotated[str | None, typer.Option(help="Lens model; without it, chosen by held-out error.")] = None,
               target: Annotated[str, typer.Option(help="checkerboard, charuco, circles(_asymmetric).")] = "checkerboard",
               detector: Annotated[str | None, typer.Option(help="How to find the target; else all ways in turn.")] = None,
               marker_mm: Annotated[float | None, typer.Option(help="Side of a ChArUco board's markers, mm; without it, "
                                                                    "3/4 of a square.")] = None,
               dictionary: Annotated[str, typer.Option(help="A ChArUco board's markers, in OpenCV's words.")] = "DICT_4X4_50",
               window: Annotated[float, typer.Option(help="Half width of the corner refinement in squares, kept within "
                                                          "what the target allows.")] = 0.2,
               skew: Annotated[bool, typer.Option("--skew", help="Also fit a skew of the image's axes.")] = False,
               map_: Map = None, map_out: MapOut = None, json_: Json = False) -> None:
    """Lens and camera matrix from views of a flat target."""
    from ..records import DISTORTION_NAMES
    if model is not None and model not in DISTORTION_NAMES:
        raise UsageError(f"no lens model '{model}'", mend=f"choose one of: {', '.join(DISTORTION_NAMES)}")
    settings = {"board": board_size(board), "square_mm": square_mm, "model": model, "target": target, "detector": detector,
                "marker_mm": marker_mm, "dictionary": dictionary, "window": window, "skew": skew}
    _measure("intrinsics", "light", frames, settings, map_, map_out, json_)


def dark(frames: Frames, map_: Map = None, map_out: MapOut = None,
         hot_rate: Annotated[float, typer.Option(help="Dark rate above the local median that makes a pixel hot, e-/s "
                                                      "(DN/s where the gain is unknown).", min=0)] = 20.0,
         json_: Json = False) -> None:
    """Offset, dark current, read noise and hot pixels from capped frames."""
    _measure("dark", "dark", frames, {"hot_rate_per_s": hot_rate}, map_, map_out, json_)


def flat(frames: Frames, map_: Map = None, map_out: MapOut = None, json_: Json = False) -> None:
    """Pixel response, illumination and gain from evenly lit frames (with darks among them, or in the map)."""
    _measure("flat", "flat", frames, {}, map_, map_out, json_)


def psf(frames: Frames, map_: Map = None, map_out: MapOut = None,
        from_stars: Annotated[bool, typer.Option("--from-stars", help="The frames are of the sky: isolated stars in place of "
                                                                      "pinholes.")] = False,
        zero_point: Annotated[float | None, typer.Option(help="Magnitude of a star that gives one electron a second, for the "
                                                              "limiting magnitude.")] = None,
        star_exposure: Annotated[float | None, typer.Option(help="Exposure for which the faintest star is told, s; without it "
                                                                 "the frames'.", min=0)] = None,
        json_: Json = False) -> None:
    """The point spread function over the field from frames of pinhole spots, or of stars."""
    settings = {"from_stars": from_stars, "zero_point_mag": zero_point, "star_exposure_s": star_exposure}
    _measure("psf", "light", frames, settings, map_, map_out, json_)


COMMANDS = (intrinsics, dark, flat, psf)


LARGEST_BOARD = 60


def board_size(text: str) -> tuple[int, int]:
    """"9x6" -> (9, 6).

    Raises:
        UsageError: not of that form.
    """
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(p.isdigit() for p in parts):
        raise UsageError(f"--board {text}: not a board size", mend="inner corners, columns x rows, like --board 9x6")
    columns, rows = int(parts[0]), int(parts[1])
    if not (3 <= columns <= LARGEST_BOARD and 3 <= rows <= LARGEST_BOARD):
        raise UsageError(f"--board {text}: a board has 3 to {LARGEST_BOARD} inner corners a side")
    return columns, rows


def _measure(name: str, kind: str, arguments: list[Path], settings: dict, map_: Path | None, map_out: Path | None,
             as_json: bool) -> None:
    from ..io.frames import find_frames
    from ..session.measuring import measure
    from ..session.reading import read_arguments
    calmap = given_map(map_)
    paths = find_frames(arguments)
    with progress() as tell:
        frames, rejected = read_arguments(arguments, paths, kind, lambda done: tell("read frames", done, len(paths)))
        tell(f"measure {name}", 0, 1)
        measurement = measure(name, frames, calmap, settings)
    finish_measurement(measurement, rejected, calmap, map_out, as_json)


def given_map(path: Path | None) -> CalibrationMap | None:
    """The map of `--map`, if one was named; what reads it is loaded only then."""
    if path is None:
        return None
    from ..io.map_file import read_map
    return read_map(path)


def finish_measurement(measurement: Measurement, rejected: list[tuple[str, str]], calmap: CalibrationMap | None,
                       map_out: Path | None, as_json: bool) -> None:
    """Write the map that was asked for, then print the measurement."""
    from ..session.results import measurement_json
    if map_out:
        from ..io.map_file import write_map
        from ..session.measuring import into_map
        write_map(map_out, into_map([measurement], calmap))
    values = measurement_json(measurement)
    values["frames_rejected"] = [{"file": f, "reason": r} for f, r in rejected] + values["frames_rejected"]
    values["map_written"] = str(map_out) if map_out else None
    print_json(values) if as_json else _print(values)


def _print(values: dict) -> None:
    rows = [(n, q["value"] if q["value"] is not None else "-", q["uncertainty"], q["unit"], q.get("reason", ""))
            for n, q in values["quantities"].items()]
    print(table(("quantity", "value", "1 sigma", "unit", "remark"), [(n, number(v, 6), number(u, 2), x, r)
                                                                     for n, v, u, x, r in rows]))
    defects = {k: v for k, v in values.get("defects", {}).items() if v}
    if "defects" in values:
        print("\ndefective pixels: " + (", ".join(f"{v} {k}" for k, v in defects.items()) or "none"))
    if "views" in values:
        print("\n" + table(("view", "rms (px)", "left out: rms (px)", "left out: corners move (sd)"),
                           [(v["file"], *(number(v[name], 3) for name in ("rms_px", "left_out_rms_px", "effect_sd")))
                            for v in sorted(values["views"], key=lambda v: -(v["effect_sd"] or 0))]))
    print(f"\nframes used: {values['frames_used']}")
    for entry in values["frames_rejected"]:
        say(f"left out {entry['file']}: {entry['reason']}")
    for warning in values["warnings"]:
        say(f"warning: {warning}")
    if values["map_written"]:
        say(f"map written: {values['map_written']}")
