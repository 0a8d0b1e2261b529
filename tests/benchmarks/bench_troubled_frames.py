"""Frames in trouble at full count: status and reason of each kind. `make bench`; CALIBENCH_TROUBLED: frames a kind (25)."""

from __future__ import annotations

import collections
import importlib.util
import os
import re
from pathlib import Path

import pytest

from calibench.session.sky import Sky

FRAMES = int(os.environ.get("CALIBENCH_TROUBLED", 25))
SPEC = importlib.util.spec_from_file_location("troubled", Path(__file__).parents[1] / "hostile" / "test_troubled_frames.py")
troubled = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(troubled)


@pytest.mark.parametrize("name", troubled.TROUBLES)
def test_frames_in_trouble(name):
    trouble, sky = troubled.TROUBLES[name], Sky()
    found = [troubled.outcome(sky, trouble, seed) for seed in range(FRAMES)]
    statuses = collections.Counter(one.status for one in found)
    reasons = collections.Counter(re.sub(r"[\d.]+(e-\d+)?", "#", one.reason) for one in found if one.reason)
    print(f"\n{name}: {dict(statuses)}, {sum(one.wrong for one in found)} wrong; "
          + "; ".join(f"{count} x {reason}" for reason, count in reasons.most_common(3)), flush=True)
    assert not any(one.wrong for one in found)
    assert trouble.least <= statuses["solved"] / FRAMES <= trouble.most
