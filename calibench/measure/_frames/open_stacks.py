"""Stacks that frames are being added to, in any order, within a bound of memory."""

from __future__ import annotations

from collections.abc import Hashable, Iterator

from ...records import Frame
from .stack import BATCH, Accumulator

OPEN_BYTES, BYTES_A_PIXEL = 250_000_000, 12  # what open stacks may take together; what the sums of one take as a rule


class OpenStacks:
    """Accumulators by key. Where one more would take too much memory, the one used last gives way: where levels follow one
    another it is complete, and where they take turns the others stay whole."""

    def __init__(self, most_bytes: int = OPEN_BYTES):
        self._most_bytes = most_bytes
        self._stacks: dict[Hashable, Accumulator] = {}  # the last used is last

    def __contains__(self, key: Hashable) -> bool:
        return key in self._stacks

    def __getitem__(self, key: Hashable) -> Accumulator:
        return self._stacks[key]

    def add(self, key: Hashable, frame: Frame) -> tuple[Hashable, Accumulator] | None:
        """Add a frame to the stack of its key. Gives the stack that had to make room for it, if one had to.

        Raises:
            BadInput: as `Accumulator.add`.
        """
        most = max(2, self._most_bytes // (BYTES_A_PIXEL * frame.data.size))
        full = key not in self._stacks and len(self._stacks) >= most
        given_up = self._stacks.popitem() if full else None
        stack = self._stacks[key] = self._stacks.pop(key, None) or Accumulator()
        stack.add(frame)
        if sum(other.waiting for other in self._stacks.values()) > BATCH:
            max(self._stacks.values(), key=lambda other: other.waiting).settle()
        return given_up

    def empty(self) -> Iterator[tuple[Hashable, Accumulator]]:
        """Every stack, each forgotten as it is handed out."""
        for key in list(self._stacks):
            yield key, self._stacks.pop(key)
