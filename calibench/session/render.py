"""Render a whole lab session of the simulated camera into a folder, with its protocol and truth.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import BadInput
from ..geometry import sphere
from ..io import atomic
from ..io.frame_writer import write_frame
from ..io.observer import observer_at
from ..io.star_table import load_star_table
from ..io.toml_text import dumps
from ..simulate.camera import thesis_camera
from ..simulate.session import SessionPlan, emva_plan, render_session, sample_plan, thesis_plan
from ..simulate.truth import camera_truth
from ..validate.case import SkyTruth
from .places import SESSION_FILE, TRUTH_FILE, protocol_file

PLANS: dict[str, Callable[[], SessionPlan]] = {"sample": sample_plan, "thesis": thesis_plan, "emva": emva_plan}
PROTOCOLS = {"sample": "star_camera", "thesis": "star_camera", "emva": "sensor_emva"}


def frames_of(plan: SessionPlan) -> int:
    """How many frames a plan has."""
    ladder = 2 * sum(n for _, n in plan.ladder.shots) if plan.ladder else 0
    return (plan.board_views + sum(n for _, n in plan.darks) + sum(n for _, n in plan.flats) + plan.spot_frames + len(plan.sky)
            + ladder)


def render(folder: Path, *, plan_name: str = "sample", seed: int = 1, coupling: float = 0.0) -> Iterator[Path]:
    """Write the session frame by frame, yielding each file's path; truth.toml is written last. coupling: of the sensor.

    Raises:
        BadInput: the folder already holds something.
    """
    folder = Path(folder)
    if folder.is_dir() and any(folder.iterdir()):
        raise BadInput("this folder is not empty", file=folder, mend="name a new folder")
    camera, plan = thesis_camera(seed), PLANS[plan_name]()
    camera = replace(camera, sensor=replace(camera.sensor, coupling=coupling))
    truth = camera_truth(camera) | {"simulate": {"plan": plan_name, "seed": seed}, "frames": {}}
    for rendered in render_session(camera, load_star_table(), plan, seed=seed, observer_at=observer_at):
        frame, path = rendered.frame, folder / rendered.path
        atomic.make_folder(path.parent)
        write_frame(path, frame.data, kind=frame.kind, exposure_s=frame.exposure_s, gain_setting=frame.gain_setting,
                    temperature_c=frame.temperature_c, bit_depth=frame.bit_depth, date_obs=frame.date_obs, camera=frame.camera,
                    pixel_size_um=frame.pixel_size_um)
        truth["frames"][rendered.path] = rendered.truth
        yield path
    atomic.write_bytes(folder / SESSION_FILE, protocol_file(PROTOCOLS[plan_name]).read_bytes())
    atomic.write_bytes(folder / TRUTH_FILE, dumps(truth).encode())


def load_truth(path: Path) -> dict:
    """The tables of a truth.toml.

    Raises:
        BadInput: missing or not TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise BadInput(f"not a readable truth file ({fault})", file=path) from fault


def sky_truth(truth: dict, name: str) -> SkyTruth | None:
    """Truth of one sky frame by its file name, or None where the file does not speak of it."""
    for path, entry in truth.get("frames", {}).items():
        if path.rsplit("/", 1)[-1] == name and entry.get("scene") == "sky":
            centre = sphere.unit_from_radec(np.radians(entry["ra_deg"]), np.radians(entry["dec_deg"]))
            return SkyTruth(centre_icrs=centre, roll_rad=float(np.radians(entry["roll_deg"])))
    return None
