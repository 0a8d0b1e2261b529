"""The commands, gathered, and what happens to errors: one readable message, an exit code, never a traceback."""

from __future__ import annotations

import json
import sys

import typer

from ..errors import CalibenchError
from . import catalogue, maps, measuring, sessions, simulating, sky, transfer

TyperUsageError = typer.BadParameter.__base__  # typer exports only this child of its usage error

app = typer.Typer(name="calibench", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
                  help="Camera calibration and characterization for star cameras: from lab frames to an attitude.",
                  rich_markup_mode=None)
for room in (sessions, measuring, transfer, sky):
    for command in room.COMMANDS:
        app.command(name=command.__name__.replace("_", "-"))(command)
app.add_typer(maps.app, name="map")
app.add_typer(catalogue.app, name="catalogue")
app.add_typer(simulating.app, name="simulate")


def main() -> None:
    """Run the command line and exit: 0 done, 1 a limit failed or a frame had no solution, 2 usage, 3 bad input."""
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except CalibenchError as fault:
        _fail(str(fault), fault.exit_code, what=fault.what, file=str(fault.file) if fault.file else None, mend=fault.mend)
    except TyperUsageError as fault:
        hint = fault.ctx.get_usage() if fault.ctx else None
        _fail(fault.format_message() + (f"\n  {hint}" if hint else ""), 2, what=fault.format_message(), file=None, mend=hint)
    except OSError as fault:  # what no room foresaw: a disk that went away, rights that changed under way
        _fail(f"{fault.filename or ''}: {fault.strerror or fault}".lstrip(": "), 3, what=str(fault.strerror or fault),
              file=str(fault.filename) if fault.filename else None, mend=None)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted; files already written are whole", 130, what="interrupted", file=None, mend=None)


def _fail(message: str, code: int, **error: str | None) -> None:
    """Say it to the person, and with --json to the program, then leave."""
    print(f"calibench: {message}", file=sys.stderr)
    if "--json" in sys.argv:
        print(json.dumps({"error": error}))
    sys.exit(code)
