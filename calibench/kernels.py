"""Compiled kernels: what every file of this name needs.

A kernel is a plain loop over arrays, compiled by numba at its first call and kept on disk beside its file (or in the
user's cache folder where that is read-only), so that a machine compiles it once. Each kernel has a plain numpy form in
the tests, which it must match.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numba
from numba.core import event


def compiled(kernel: Callable) -> Callable:
    """Decorator of a kernel: no Python objects, no bounds checks, division by zero gives inf or NaN as in numpy."""
    return numba.njit(cache=True, nogil=True, error_model="numpy")(kernel)


def any_order(kernel: Callable) -> Callable:
    """As `compiled`; sums may be reordered, so that they fill the vector unit. NaN and infinity keep their meaning."""
    return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})(kernel)


class _Announcement(event.Listener):
    """Says once in a process, on stderr, that kernels are being compiled: else the first frame only looks slow."""

    def __init__(self) -> None:
        self._said = False

    def on_start(self, event: event.Event) -> None:
        if not self._said:
            self._said = True
            print("calibench: compiling its kernels for this machine; done once, takes some seconds", file=sys.stderr)

    def on_end(self, event: event.Event) -> None:
        pass


event.register("numba:compile", _Announcement())  # not raised where the compiled form is found on disk
