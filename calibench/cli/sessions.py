"""Sessions: demo, new, plan, check, run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import BadInput
from .output import Json, number, print_json, progress, say, table

Session = Annotated[Path, typer.Argument(metavar="SESSION", help="A session folder (it holds session.toml).")]
Out = Annotated[Path | None, typer.Option(help="Folder for map, results and report.")]


def demo(out: Annotated[Path, typer.Option(help="Folder for map, results and report.")] = Path("out/demo"),
         json_: Json = False) -> None:
    """The main job on the sample session that comes with calibench."""
    from ..session.places import sample_frames
    _run(sample_frames(), out, json_)


def new(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A new session folder.")],
        protocol: Annotated[str, typer.Option(help="Protocol to start from.")] = "star_camera", json_: Json = False) -> None:
    """A new session: its protocol as session.toml, and a folder for each kind of frame."""
    from ..io import atomic
    from ..session.places import SESSION_FILE, protocol_file
    from ..session.protocol import load_protocol
    source = protocol_file(protocol)
    if (folder / SESSION_FILE).exists():
        raise BadInput("there is a session in this folder already", file=folder / SESSION_FILE, mend="name a new folder")
    shots = load_protocol(source)[0].shot
    for shot in shots:
        atomic.make_folder(folder / shot.folder)
    atomic.write_bytes(folder / SESSION_FILE, source.read_bytes())
    if json_:
        print_json({"session": str(folder), "protocol": protocol, "folders": [shot.folder for shot in shots]})
    else:
        say(f"session in {folder}: edit {folder / SESSION_FILE}, then: calibench plan {folder}")


def plan(session: Session, json_: Json = False) -> None:
    """The shot list: what to take, why, and how much of it is there."""
    from ..session.shots import open_session, shot_files
    protocol, _ = open_session(session)
    here = session if session.is_dir() else session.parent
    shots = [{"name": s.name, "folder": s.folder, "frames_wanted": s.frames, "exposures_wanted": s.exposures,
              "frames_found": len(shot_files(here, s)) if session.is_dir() else 0, "optional": s.optional, "measure": s.measure,
              "what": s.what, "why": s.why} for s in protocol.shot]
    if json_:
        print_json({"protocol": protocol.protocol.name, "why": protocol.protocol.why, "shots": shots})
        return
    print(f"{protocol.protocol.name}: {protocol.protocol.why}\n")
    for shot in shots:
        there = f"{shot['frames_found']} of {shot['frames_wanted']}{' (optional)' if shot['optional'] else ''}"
        several = f", {shot['exposures_wanted']} exposures" if shot["exposures_wanted"] > 1 else ""
        print(f"{shot['folder']}/  {there} frames{several}\n  {shot['what']}\n  why: {shot['why']}")


def check(session: Session, json_: Json = False) -> None:
    """Are the frames what the protocol asks for? Quick enough to ask while the camera is still on the bench."""
    from dataclasses import asdict

    from ..session.run import check_session
    from ..session.shots import open_session
    protocol, _ = open_session(session)
    with progress() as tell:
        _, shots = check_session(session, protocol, tell)
    if json_:
        print_json({"shots": [asdict(shot) for shot in shots]})
    else:
        print(table(("shot", "frames", "wanted", "status"), [(s.name, s.found, s.wanted, s.status) for s in shots]))
        for shot in shots:
            for remark in shot.remarks:
                say(f"{shot.name}: {remark}")
    raise typer.Exit(1 if any(shot.status == "fail" for shot in shots) else 0)


def run(session: Session, out: Out = None, json_: Json = False) -> None:
    """A whole session: measure, map, solve the sky frames, judge, report."""
    _run(session, out or session / "out", json_)


COMMANDS = (demo, new, plan, check, run)


def _run(session: Path, out: Path, as_json: bool) -> None:
    import json

    from ..session.run import run_session
    with progress() as tell:
        result = run_session(session, out, tell)
    if as_json:
        print_json(json.loads(result.results_path.read_text()) | {
            "map": str(result.map_path), "report": str(result.report_path), "results": str(result.results_path)})
    else:
        _print(result)
    raise typer.Exit(0 if result.ok else 1)


def _print(result: object) -> None:
    story = result.story
    rows = [(f"{v.limit.measurement}.{v.limit.quantity}", number(v.value, 4), v.status, v.reason) for v in story.verdicts]
    print(table(("limit", "value", "status", "reason"), rows))
    if trial := story.trials.get("ablation"):
        print("\nWhat each layer of the map earned\n")
        print(table(trial.columns, trial.rows))
        print(f"\n{trial.reading}")
    for warning in story.calmap.warnings:
        say(f"warning: {warning}")
    print(f"\nmap      {result.map_path}\nresults  {result.results_path}\nreport   {result.report_path}")
