"""All identifiers and all attitude methods beside each other. `make bench`; CALIBENCH_ATTITUDES: frames a condition (300).

CPU time of this process; what is asserted is what must hold on any machine.
"""

from __future__ import annotations

import os

import pytest

from calibench.io.star_table import load_star_table
from calibench.records import CalibrationMap, Intrinsics, Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.validate.case import Trial
from calibench.validate.trials import attitude_methods, identifiers

FRAMES = int(os.environ.get("CALIBENCH_ATTITUDES", 300))
LENS = Intrinsics.pinhole(focal_px=1416.7, image_size_px=(752, 480), focal_sd_px=0.0)
CALMAP = CalibrationMap(image_size_px=(752, 480), intrinsics=LENS, measured=frozenset({"intrinsics"}))


@pytest.fixture(scope="module")
def sky() -> SkyCatalogue:
    return SkyCatalogue.seen_by(load_star_table(), Observer())


def made(module, sky, monkeypatch) -> Trial:
    """A trial at full count, printed."""
    monkeypatch.setattr(module, "FRAMES", FRAMES)
    found, _ = module.trial([None], CALMAP, lambda case: LostInSpace(sky=sky))
    print(f"\n{'  '.join(found.columns)}")
    for row in found.rows:
        print("  ".join(f"{value:.4g}" if isinstance(value, float) else str(value) for value in row))
    return found


def test_identifiers(sky, monkeypatch):
    found = made(identifiers, sky, monkeypatch)
    assert sum(row[found.columns.index("wrong")] for row in found.rows) == 0


def test_attitude_methods(sky, monkeypatch):
    found = made(attitude_methods, sky, monkeypatch)
    assert all(0.5 < row[found.columns.index("nees")] < 1.5 for row in found.rows)
