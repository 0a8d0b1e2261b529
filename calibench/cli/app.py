"""The commands, gathered, and what happens to errors: one readable message, an exit code, never a traceback."""

from __future__ import annotations

import json
import sys

import typer

from ..errors import CalibenchError
from . import maps, measuring, sessions, simulating, sky

app = typer.Typer(name="calibench", no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
                  help="Camera calibration and characterization for star cameras: from lab frames to an attitude.",
                  rich_markup_mode=None)
for room in (sessions, measuring, sky):
    for command in room.COMMANDS:
        app.command(name=command.__name__)(command)
app.add_typer(maps.app, name="map")
app.add_typer(simulating.app, name="simulate")


def main() -> None:
    """Run the command line and exit: 0 done, 1 a limit failed or a frame had no solution, 2 usage, 3 bad input."""
    try:
        app(standalone_mode=True)
    except CalibenchError as fault:
        print(f"calibench: {fault}", file=sys.stderr)
        if "--json" in sys.argv:
            error = {"what": fault.what, "file": str(fault.file) if fault.file else None, "mend": fault.mend}
            print(json.dumps({"error": error}))
        sys.exit(fault.exit_code)
    except KeyboardInterrupt:
        print("calibench: interrupted; files already written are whole", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:  # the reader of a pipe (head) has gone
        sys.stderr.close()
        sys.exit(0)
