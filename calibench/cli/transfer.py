"""calibench transfer: a photon transfer series to an EMVA 1288 style datasheet. calibench datasheet: the same from a map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import UsageError
from .measuring import Map, MapOut, finish_measurement, given_map
from .output import Json, print_json, progress, say

SUFFIXES = (".html", ".pdf", ".json", ".csv")


def transfer(frames: Annotated[list[Path] | None, typer.Argument(metavar="[FRAMES]...",
                                                                 help="Frame files and folders, darks among them.")] = None,
             descriptor: Annotated[Path | None, typer.Option(help="An EMVA 1288 descriptor, in place of FRAMES.")] = None,
             irradiance: Annotated[float, typer.Option(help="Photons a pixel receives each second, where the lamp is constant "
                                                            "and known.", min=0)] = 0.0,
             lens: Annotated[str, typer.Option(help="Was a lens mounted: yes or no.")] = "",
             datasheet_: Annotated[Path | None, typer.Option("--datasheet", help="Write a datasheet: .html, .pdf, .json or "
                                                                                 ".csv.")] = None,
             map_: Map = None, map_out: MapOut = None, json_: Json = False) -> None:
    """Gain, quantum efficiency, noise, saturation, linearity and nonuniformity, after EMVA 1288 release 4."""
    from ..session.measuring import into_map, measure
    if bool(frames) == bool(descriptor):
        raise UsageError("transfer wants either FRAMES or --descriptor FILE")
    if datasheet_:
        _known_suffix(datasheet_)
    calmap = given_map(map_)
    settings = {"irradiance_photons_per_px_s": irradiance, "lens": lens}
    with progress() as tell:
        series, rejected = _described(descriptor, tell) if descriptor else _named(frames, tell)
        measurement = measure("transfer", series, calmap, settings)
    if datasheet_:
        _write(datasheet_, into_map([measurement], None))
        say(f"datasheet written: {datasheet_}")
    finish_measurement(measurement, rejected, calmap, map_out, json_)


def datasheet(map_: Annotated[Path, typer.Argument(metavar="MAP", help="A map that holds a `transfer` measurement.")],
              out: Annotated[Path, typer.Option(help="The file to write: .html, .pdf, .json or .csv.")],
              json_: Json = False) -> None:
    """The EMVA 1288 style datasheet of a map that was made with `transfer`."""
    from ..io.map_file import read_map
    _known_suffix(out)
    _write(out, read_map(map_))
    if json_:
        print_json({"map": str(map_), "datasheet": str(out)})
    else:
        say(f"datasheet written: {out}")


COMMANDS = (transfer, datasheet)


def _described(descriptor: Path, tell: object) -> tuple[object, list]:
    from ..io.descriptor import described_frames, read_descriptor
    described = read_descriptor(descriptor)

    def told() -> object:
        for i, frame in enumerate(described_frames(described)):
            tell("read frames", i, len(described.frames))
            yield frame
    return told(), []


def _named(arguments: list[Path], tell: object) -> tuple[object, list]:
    from ..io.frames import find_frames
    from ..session.reading import read_arguments
    paths = find_frames(arguments)
    return read_arguments(arguments, paths, "flat", lambda done: tell("read frames", done, len(paths)))


def _known_suffix(path: Path) -> None:
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"a datasheet is written as {', '.join(SUFFIXES)}, not '{path.suffix}'")


def _write(path: Path, calmap: object) -> None:
    from ..io.atomic import write_bytes
    from ..report.datasheet import datasheet as made
    write_bytes(path, made(calmap, path.suffix.lower()))
