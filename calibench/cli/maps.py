"""calibench map info | verify | apply | export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import BadInput
from .output import Json, print_json, progress, say, table

app = typer.Typer(no_args_is_help=True, help="Look at, check, apply and export a calibration map.", rich_markup_mode=None)
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
        print(f"{verdict.get('status', '?')}: {verdict}")


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
    from ..calmap.correct import correct, interpolate_defects, outside_conditions
    from ..io.corrected_writer import write_corrected
    from ..io.frames import find_frames, read_frame
    from ..io.map_file import read_map
    calmap, written = read_map(map_), []
    paths = find_frames(frames)
    with progress() as tell:
        for i, path in enumerate(paths):
            frame = read_frame(path)
            outside = outside_conditions(frame, calmap)
            if outside and not force:
                raise BadInput("the map does not hold for this frame: " + "; ".join(outside), file=path,
                               mend="use a map made under these conditions, or --force")
            corrected = correct(frame, calmap)
            signal = interpolate_defects(corrected.signal_dn, corrected.defects) if interpolate else corrected.signal_dn
            target = out / f"{path.stem}.corrected.fits"
            out.mkdir(parents=True, exist_ok=True)
            write_corrected(target, corrected, signal, frame)
            written.append({"file": str(path), "out": str(target), "warnings": [*outside, *corrected.warnings]})
            tell("apply", i + 1, len(paths))
    if json_:
        print_json({"frames": written})
    else:
        for entry in written:
            print(entry["out"])
            for warning in entry["warnings"]:
                say(f"{entry['file']}: warning: {warning}")


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


