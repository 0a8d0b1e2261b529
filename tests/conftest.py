"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's root folder."""
    return ROOT


@pytest.fixture(scope="session")
def real() -> Path:
    """The folder of real frames; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("CALIBENCH_REAL", ROOT.parent / "shared" / "real"))
    if not folder.is_dir():
        pytest.skip("real frames are not on this machine (set CALIBENCH_REAL to their folder)")
    return folder
