"""`python -m calibench`: the command line, where the command itself is not on the path."""

from __future__ import annotations

from .cli import main

main()
