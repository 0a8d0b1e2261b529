"""Reports that belong to no session: of a series of sky frames, of a trial."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from .. import __version__
from ..io import atomic
from ..records import CalibrationMap
from ..report.build import build_report
from ..report.story import Story
from ..stars.solve import Solution
from ..validate.case import Trial


def write_series_report(path: Path, solutions: Sequence[Solution], calmap: CalibrationMap | None) -> None:
    """Write the HTML report of a series: where the camera looked, mean residuals over the field, errors by kind, and what
    the map says of itself.

    Raises:
        BadInput: the file cannot be written.
    """
    solved = [s for s in solutions if s.status == "solved"]
    size = solved[0].identification.intrinsics.image_size_px if solved else (1, 1)
    story = Story(title="Sky series", why=f"{len(solved)} of {len(solutions)} sky frames solved.",
                  created=datetime.now(UTC).isoformat(timespec="seconds"), software=f"calibench {__version__}",
                  calmap=calmap or CalibrationMap(image_size_px=size), series=tuple(solutions))
    atomic.write_bytes(path, build_report(story).encode())


def write_trial_report(path: Path, trial: Trial, calmap: CalibrationMap) -> None:
    """Write the HTML report of one trial and of the map that it was made with.

    Raises:
        BadInput: the file cannot be written.
    """
    story = Story(title=f"Trial {trial.name}", why=f"{trial.reading[:1].upper()}{trial.reading[1:]}.",
                  created=datetime.now(UTC).isoformat(timespec="seconds"), software=f"calibench {__version__}", calmap=calmap,
                  trials={trial.name: trial})
    atomic.write_bytes(path, build_report(story).encode())
