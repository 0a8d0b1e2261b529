"""The command line. Starting it loads nothing heavy: each command imports what it needs when it runs."""

from __future__ import annotations

from .app import main

__all__ = ["main"]
