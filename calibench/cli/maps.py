"""calibench map info | verify | apply | diff | import | export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import BadInput
from .output import Json, print_json, progress, say, table

app = typer.Typer(no_args_is_help=True, help="Look at, check, apply, compare, import and export a calibration map.",
                  rich_markup_mode=None)
MapArgument = Annotated[Path, typer.Argument(metavar="MAP", help="A calibration map (FITS).")]


@app.command()
def info(map_: MapArgument, json_: Json = False) -> None:
    """What a map holds, where it is valid, and what was said of it."""
    from ..io.map_file import map_info
    values = map_info(map_)
    if json_:
        print_json(values)
        return
    print(f"{map_}: schema {values['schema']}, created {values['created']}")
    for part in ("camera", "conditions"):
        print(f"{part}: " + (", ".join(f"{k} {v}" for k, v in values[part].items() if v not in (None, "", [])) or "not stated"))
    print(table(("layer", "measured"), [(n, "yes" if layer["measured"] else "no") for n, layer in values["layers"].items()]))
    for verdict in values["verdicts"]:
        limit = verdict["limit"]
        print(f"{verdict['status']}: {limit['measurement']}.{limit['quantity']}: {verdict['reason']}")


@app.command()
def verify(map_: MapArgument, json_: Json = False) -> None:
    """Check a map file: checksums, required parts, schema. Exit 3 where it is damaged."""
    from ..io.map_file import verify_map
    checks = verify_map(map_)
    good = all(check.ok for check in checks)
    if json_:
        print_json({"file": str(map_), "ok": good, "checks": [check._asdict() for check in checks]})
    else:
        print(table(("check", "ok", "detail"), [(c.name, "yes" if c.ok else "NO", c.detail) for c in checks]))
    raise typer.Exit(0 if good else BadInput.exit_code)


@app.command()
def apply(map_: MapArgument,
          frames: Annotated[list[Path], typer.Argument(metavar="FRAMES...", help="Frame files and folders.")],
          out: Annotated[Path, typer.Option(help="Folder for the corrected frames (FITS).")],
          force: Annotated[bool, typer.Option("--force", help="Apply outside the map's conditions too.")] = False,
          interpolate: Annotated[bool,
                                 typer.Option("--interpolate", help="Fill unusable pixels by their neighbours.")] = False,
          json_: Json = False) -> None:
    """Correct frames: signal, variance and defect mask as three extensions of a FITS file."""
    from ..calmap.correct import correct, interpolate_defects, outside_conditions, require_size
    from ..io.atomic import make_folder
    from ..io.corrected_writer import write_corrected
    from ..io.frames import find_frames, read_frame
    from ..io.map_file import read_map
    calmap, written = read_map(map_), []
    paths = find_frames(frames)
    targets = {path: out / f"{path.stem}.corrected.fits" for path in paths}
    if len(set(targets.values())) < len(paths):
        raise BadInput("two of the frames have the same name and would overwrite each other", file=out,
                       mend="apply the map folder by folder, each into an --out of its own")
    with progress() as tell:
        for path in paths:  # all are judged before the first is written
            frame = read_frame(path)
            outside = outside_conditions(frame, calmap)
            if outside and not force:
                raise BadInput("the map does not hold for this frame: " + "; ".join(outside), file=path,
                               mend="use a map made under these conditions, or --force")
            require_size(frame, calmap)
        make_folder(out)
        for i, path in enumerate(paths):
            frame = read_frame(path)
            outside = outside_conditions(frame, calmap)
            corrected = correct(frame, calmap)
            signal = interpolate_defects(corrected.signal_dn, corrected.defects) if interpolate else corrected.signal_dn
            write_corrected(targets[path], corrected, signal, frame)
            written.append({"file": str(path), "out": str(targets[path]), "warnings": [*outside, *corrected.warnings]})
            tell("apply", i + 1, len(paths))
    if json_:
        print_json({"frames": written})
    else:
        for entry in written:
            print(entry["out"])
            for warning in entry["warnings"]:
                say(f"{entry['file']}: warning: {warning}")


@app.command()
def diff(a: Annotated[Path, typer.Argument(metavar="A", help="The calibration map to compare with.")],
         b: Annotated[Path, typer.Argument(metavar="B", help="Another map of the same camera.")],
         fit_radius_px: Annotated[float | None, typer.Option(
             min=0, help="Remove the rotation that fits within this distance of the centre; without it, over the whole image."
         )] = None, json_: Json = False) -> None:
    """What has changed from map A to map B: the lens over the field, each layer, the defective pixels."""
    from ..calmap.compare import compare
    from ..io.map_file import read_map
    from .difference import difference_json, difference_text
    first, second = read_map(a), read_map(b)
    values = {"a": str(a), "b": str(b)} | difference_json(compare(first, second, fit_radius_px), first, second)
    print_json(values) if json_ else print(difference_text(values))


@app.command("import")
def import_(file: Annotated[Path, typer.Argument(metavar="FILE", help="The lens file of another program.")],
            from_: Annotated[str, typer.Option("--from", help="Its format, like opencv_yaml.")],
            map_out: Annotated[Path, typer.Option(help="Map to write.")],
            map_: Annotated[Path | None, typer.Option("--map", help="A map to which the lens is added.")] = None,
            json_: Json = False) -> None:
    """Take the lens from another program's file into a map."""
    from ..io.imported_lens import imported_lens
    from ..io.map_file import map_info, read_map, write_map
    from ..session.measuring import into_map
    measurement = imported_lens(file, from_)
    write_map(map_out, into_map([measurement], read_map(map_) if map_ else None))
    if json_:
        print_json({"file": str(file), "format": from_, "map_written": str(map_out),
                    "intrinsics": map_info(map_out)["intrinsics"], "warnings": list(measurement.warnings)})
        return
    print(map_out)
    for warning in measurement.warnings:
        say(f"warning: {warning}")


@app.command()
def export(map_: MapArgument,
           to: Annotated[str, typer.Option(help="Format, like opencv_yaml.")],
           out: Annotated[Path, typer.Option(help="File to write.")], json_: Json = False) -> None:
    """Write the lens in another program's format."""
    from .. import registry
    from ..io.map_file import read_map
    module = registry.load("calibench.io.exports", to)
    module.export(read_map(map_), out)
    print_json({"file": str(out), "format": to}) if json_ else print(out)
