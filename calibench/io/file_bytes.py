"""The bytes of a file, in memory that serves again: fresh memory for each frame costs twice the reading (page faults)."""

from __future__ import annotations

import ctypes
import weakref
from collections import deque
from pathlib import Path

import numpy as np

from ..errors import BadInput
from .readers._reading import MAX_PIXELS

MAX_FILE_BYTES = 8 * MAX_PIXELS
MOST_SPARE = 4
_spare: deque[np.ndarray] = deque(maxlen=MOST_SPARE)
_reading = False
_trim = getattr(ctypes.pythonapi, "malloc_trim", None)  # glibc keeps free memory that lies between arrays in use


def file_bytes(path: Path) -> memoryview:
    """All bytes of a file. Their memory is used again once nothing refers to them or to an array made of them.

    Raises:
        BadInput: the file is missing, empty, or longer than any frame.
    """
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise BadInput(f"{size} bytes are more than any frame of {MAX_PIXELS // 10**6} megapixels needs", file=path,
                           mend="leave it out")
        raw, held = _memory(max(size, 1)), 0
        with open(path, "rb", buffering=0) as file:
            while held < size and (count := file.readinto(raw[held:])):
                held += count
    except OSError as error:
        raise BadInput(f"cannot be opened: {error.strerror or error}", file=path,
                       mend="check the path and the rights") from error
    if not held:
        raise BadInput("is empty (0 bytes)", file=path, mend="copy it again from the camera, or leave it out")
    return raw[:held].toreadonly()


def free_spare() -> None:
    """Give free memory back to the system: no more files for now. What is still in use will not be kept either."""
    global _reading
    _reading = False
    _spare.clear()
    if _trim is not None:
        _trim(0)


def _memory(size: int) -> memoryview:
    global _reading
    _reading = True
    try:
        memory = _spare.pop()
    except IndexError:
        memory = None
    if memory is None or not size <= len(memory) <= 2 * size:
        memory = np.empty(size, np.uint8)
    lent = np.frombuffer(memoryview(memory)[:size], np.uint8)  # an array of its own: it dies with the last view of it
    weakref.finalize(lent, _keep, memory).atexit = False
    return memoryview(lent)


def _keep(memory: np.ndarray) -> None:
    if _reading:
        _spare.append(memory)
