"""FrameSeries: the frames of many files, read when they are asked for, as often as they are asked for.

A first pass hands frames on as they come and checks the series on the way. Where no source states the converter's bits, that
takes foresight (the range is what the brightest value of the series needs): then all files are read once before the first
frame is handed on. Only a small series is kept in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

from ..errors import BadInput
from ..records import Frame
from .file_bytes import free_spare
from .frame_seen import FrameSeen, seen
from .read_ahead import read_ahead
from .series_checks import Groups, aligned_alike, check_series, duplicate_noted, refuse_automatic

KEPT_BYTES = 256_000_000
Read = Callable[[Path, str], Frame | BadInput]


class FrameSeries:
    """Frames of one series of files, in order; may be iterated again.

    Args:
        read: (file, its sha256 or "" where that is not known) -> the frame, or why it is left out; raises what must not be
            passed over.
        tell: called with the number of files done, in each pass.
        may_be_empty: no usable frame is no error.

    `rejected`: (file, reason) of what was left out, complete after the first pass. Iterating raises BadInput: no frame
    is left, settings are mixed or levels show automatic exposure or gain at work (`series_checks`), a file changes between
    two passes.
    """

    def __init__(self, paths: Sequence[Path], read: Read, *, tell: Callable[[int], None] = lambda done: None,
                 may_be_empty: bool = False):
        self._paths, self._read, self._tell, self._may_be_empty = tuple(paths), read, tell, may_be_empty
        self._kept: dict[Path, Frame] = {}  # as read
        self._left_out: set[Path] = set()
        self._stamp: dict[Path, tuple[int, int]] = {}
        self._seen: dict[Path, FrameSeen] = {}
        self._complete = False
        self.rejected: list[tuple[str, str]] = []

    @property
    def seen(self) -> tuple[FrameSeen, ...]:
        """What was seen of each frame; reads all files where that was not done yet. Raises what iterating raises."""
        if not self._complete:
            self._survey()
        return tuple(self._seen.values())

    def __iter__(self) -> Iterator[Frame]:
        if not self._complete and self._needs_foresight():
            self._survey()
        if not self._complete:
            yield from self._first_pass()
        else:
            yield from (self._seen[path].settle(frame) for path, frame in self._frames())

    def _needs_foresight(self) -> bool:
        frames = (frame for frame in map(self._one, self._paths) if isinstance(frame, Frame))
        return any(frame.range_assumed for frame in islice(frames, 1))

    def _survey(self) -> None:
        found = {path: seen(frame) for path, frame in self._frames()}
        self._finish(dict(zip(found, check_series(list(found.values())), strict=True)))

    def _first_pass(self) -> Iterator[Frame]:
        found: dict[Path, FrameSeen] = {}
        groups, hashes = Groups(), {}
        for path, frame in self._frames():
            found[path] = duplicate_noted(aligned_alike(seen(frame), found.values()), hashes)
            groups.add(found[path])
            if not groups.mixed:  # else the rest is read for the table of groups only
                yield found[path].settle(frame)
        groups.require_one()
        refuse_automatic(list(found.values()))
        self._finish(found)

    def _finish(self, found: dict[Path, FrameSeen]) -> None:
        if not found and not self._may_be_empty:
            lines = "".join(f"\n  {file}: {why}" for file, why in self.rejected)
            raise BadInput(f"no frame could be used:{lines}")
        self._seen, self._complete = found, True

    def _frames(self) -> Iterator[tuple[Path, Frame]]:
        """Every usable frame as it was read; the others go to `rejected`."""
        paths = [path for path in self._paths if path not in self._left_out]
        for done, (path, frame) in enumerate(zip(paths, read_ahead(self._one, paths), strict=True)):
            self._tell(done)
            if isinstance(frame, BadInput):
                self._left_out.add(path)
                self.rejected.append((str(path), frame.what))
                continue
            if frame.data.nbytes * len(self._paths) <= KEPT_BYTES:
                self._kept[path] = frame
            yield path, frame
        free_spare()

    def _one(self, path: Path) -> Frame | BadInput:
        if path in self._kept:
            return self._kept[path]
        before = self._seen.get(path)
        stamp = _stamp(path)
        if stamp != self._stamp.setdefault(path, stamp):
            raise BadInput("was changed while it was in use", file=path, mend="measure when the camera has written all frames")
        return self._read(path, before.sha256 if before else "")


class Joined:
    """Several series one after the other; may be iterated again."""

    def __init__(self, *series: FrameSeries):
        self._series = series

    def __iter__(self) -> Iterator[Frame]:
        return chain.from_iterable(self._series)


def _stamp(path: Path) -> tuple[int, int]:
    """What changes with the file; zeros where it is gone, which its reading reports."""
    try:
        status = path.stat()
    except OSError:
        return 0, 0
    return status.st_mtime_ns, status.st_size
