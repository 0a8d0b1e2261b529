"""calibench simulate session: render a lab session of a camera whose truth is known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import UsageError
from .output import Json, print_json, progress, say

app = typer.Typer(no_args_is_help=True, help="Render frames of a camera whose truth is known.", rich_markup_mode=None)


@app.callback()
def group() -> None:
    """Keeps `session` a subcommand while it is the only one."""


@app.command()
def session(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A new folder.")],
            plan: Annotated[str, typer.Option(help="What and how much: sample, thesis or emva.")] = "sample",
            seed: Annotated[int, typer.Option(min=0, help="The same seed renders the same camera and frames.")] = 1,
            coupling: Annotated[float, typer.Option(min=0, max=0.1, help="Part of a pixel's charge that shows in each of its "
                                                                         "four neighbours.")] = 0.0,
            json_: Json = False) -> None:
    """A whole protocol (boards, darks, flats, spots, sky) and its truth.toml."""
    from ..session.render import PLANS, frames_of, render
    if plan not in PLANS:
        raise UsageError(f"no plan '{plan}'", mend=f"choose one of: {', '.join(PLANS)}")
    total, count = frames_of(PLANS[plan]()), 0
    with progress() as tell:
        for path in render(folder, plan_name=plan, seed=seed, coupling=coupling):
            count += 1
            tell(f"render {path.parent.name}", count, total)
    if json_:
        print_json({"folder": str(folder), "frames": count, "plan": plan, "seed": seed})
    else:
        say(f"{count} frames in {folder}")
