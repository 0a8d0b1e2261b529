"""Frames sorted into levels (alike in kind, exposure and light), each reduced to a few figures as the frames stream by.

A level holds the sum image of its frames and nothing else of its size, and gives that up too when too many are open; the
best dark and the best bright stack keep it, for the fixed patterns. Formulas: EMVA 1288 R4 Linear, 6 (pairs), 8 (stacks).
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np

from ...errors import BadInput
from ...records import Frame
from . import kernels

OPEN_BYTES = 200e6  # of sum images at a time; a level that comes again after it was given up is a level of its own
SAME_LIGHT = 0.01  # frames of one exposure whose means differ by more are different levels
SAME_LIGHT_DN = 1.0
PLANES = {"R": "r", "B": "b"}


@dataclass(frozen=True, kw_only=True)
class Level:
    """One plane of one level of light (a mosaic has four planes, else there is one).

    frame_means_dn: (L,). variance_dn2: temporal, common drift taken off (R4: the pair formula), with its 1-sigma error.
    spatial_dn2, column_dn2, row_dn2: variance of the mean image over its pixels, its column means, its row means, as measured.
    correlation_x, _y: of the difference of the first two frames with its right and lower neighbour. top_dn, at_top: largest
    value and the share of pixels that have it. pixels: how many; shape: (H, W) of the plane.
    """

    dark: bool
    exposure_s: float | None
    photons: float | None
    frame_means_dn: np.ndarray
    variance_dn2: float
    variance_error_dn2: float
    spatial_dn2: float
    column_dn2: float
    row_dn2: float
    correlation_x: float
    correlation_y: float
    top_dn: int
    at_top: float
    shape: tuple[int, int]

    @property
    def count(self) -> int:
        return len(self.frame_means_dn)

    @property
    def mean_dn(self) -> float:
        return float(self.frame_means_dn.mean())

    @property
    def pixels(self) -> int:
        return self.shape[0] * self.shape[1]


@dataclass(frozen=True, kw_only=True)
class Stack:
    """The mean image of each plane (H, W) of the level with most frames, and those levels."""

    means_dn: tuple[np.ndarray, ...]
    levels: tuple[Level, ...]


@dataclass
class _Open:
    """A level while its frames come in; lists run over the planes."""

    frame: Frame
    files: list[str] = field(default_factory=list)
    first: list[np.ndarray] = field(default_factory=list)
    total: list[np.ndarray] = field(default_factory=list)
    sums: list[list[int]] = field(default_factory=list)
    squares: list[int] = field(default_factory=list)
    tops: list[dict[int, int]] = field(default_factory=list)
    pair: list[tuple] = field(default_factory=list)


class Levels:
    """Takes frames one by one; `levels`, `stacks` and `single` are complete after `close`.

    levels: for each plane, all levels of two frames or more. single: files of levels with one frame only.
    """

    def __init__(self, bayer_pattern: str | None):
        self._places = _places(bayer_pattern)
        self._open: OrderedDict[tuple, _Open] = OrderedDict()
        self.levels: dict[str, list[Level]] = {name: [] for name in self._places}
        self.stacks: dict[bool, Stack] = {}
        self.single: list[str] = []

    def add(self, frame: Frame, photons: float | None) -> None:
        """Add a frame, dark where its kind says so. photons: that a pixel receives in this exposure; None: not stated.

        Raises:
            BadInput: its values are no whole DN of 16 bits.
        """
        data = _whole(frame)
        key = self._key(frame, photons, float(data.mean()))
        level = self._open.setdefault(key, _Open(frame=frame))
        self._open.move_to_end(key)
        level.files.append(frame.file or frame.name)
        for i, place in enumerate(self._places.values()):
            plane = np.ascontiguousarray(data[place])
            plane.flags.writeable = False  # one compiled form serves planes and whole frames
            if len(level.files) == 1:
                level.first.append(plane)
                level.total.append(np.zeros(plane.shape, np.uint32))
                level.sums.append([])
                level.squares.append(0)
                level.tops.append({})
            elif len(level.files) == 2:
                level.pair.append(kernels.difference(level.first[i], plane))
            plain, squares, maximum, at_maximum = kernels.add(plane, level.total[i])
            level.sums[i].append(plain)
            level.squares[i] += squares
            level.tops[i][maximum] = level.tops[i].get(maximum, 0) + at_maximum
        if len(level.files) == 2:
            level.first.clear()
        self._give_up_oldest()

    def close(self) -> None:
        """No more frames."""
        for key in list(self._open):
            self._close(key)

    def _key(self, frame: Frame, photons: float | None, mean_dn: float) -> tuple:
        """Of the open level that the frame belongs to, or a new one."""
        dark = frame.kind == "dark"
        if dark or photons is not None:
            return dark, frame.exposure_s, photons, 0
        same = [k for k in self._open if k[:3] == (dark, frame.exposure_s, photons)]
        for key in same:
            theirs = np.sum([s[-1] for s in self._open[key].sums]) / frame.data.size
            if abs(theirs - mean_dn) <= max(SAME_LIGHT * theirs, SAME_LIGHT_DN):
                return key
        return dark, frame.exposure_s, photons, len(self.single) + len(self.levels[next(iter(self.levels))]) + len(self._open)

    def _give_up_oldest(self) -> None:
        held = sum(t.nbytes for level in self._open.values() for t in level.total)
        for key in [k for k, level in self._open.items() if len(level.files) > 1][:-1]:
            if held <= OPEN_BYTES:
                return
            held -= sum(t.nbytes for t in self._open[key].total)
            self._close(key)

    def _close(self, key: tuple) -> None:
        level = self._open.pop(key)
        if len(level.files) < 2:
            self.single += level.files
            return
        planes = [_figures(level, i, key) for i in range(len(self._places))]
        for found, name in zip(planes, self._places, strict=True):
            self.levels[name].append(found)
        kept = self.stacks.get(key[0])
        if kept is None or _worth(planes, level.frame) > _worth(kept.levels, level.frame):
            means = tuple(total / len(level.files) for total in level.total)
            self.stacks[key[0]] = Stack(means_dn=means, levels=tuple(planes))


def _places(bayer_pattern: str | None) -> dict[str, tuple]:
    """Name of each plane (r, gr, gb, b; "" where there is no mosaic) -> its pixels."""
    if bayer_pattern is None:
        return {"": np.s_[:, :]}
    out = {}
    for i, colour in enumerate(bayer_pattern):
        y, x = divmod(i, 2)
        beside = bayer_pattern[2 * y + 1 - x].lower()
        out[PLANES.get(colour, f"g{beside}")] = np.s_[y::2, x::2]
    return out


def _whole(frame: Frame) -> np.ndarray:
    data = frame.data
    if data.dtype.kind in "ui" and data.dtype.itemsize <= 2:
        return data.astype(np.uint16, copy=False)
    if not np.array_equal(data, np.rint(data)) or data.min() < 0 or data.max() > np.iinfo(np.uint16).max:
        raise BadInput(f"pixel values are no whole DN of 16 bits ({data.dtype})", file=frame.file or None,
                       mend="give frames as the camera made them, not averaged or scaled copies")
    return data.astype(np.uint16)


def _worth(planes: tuple[Level, ...] | list[Level], frame: Frame) -> tuple:
    """What makes a good stack: lit to about half of the range, many frames, then the nearest to half."""
    off = abs(np.mean([p.mean_dn for p in planes]) / frame.white_level_dn - 0.5)
    return (planes[0].dark or off < 0.25, planes[0].count, -off if not planes[0].dark else 0)


def _figures(level: _Open, i: int, key: tuple) -> Level:
    shape, total, count = level.total[i].shape, level.total[i], len(level.files)
    n, height, width = total.size, *shape
    means = np.array(level.sums[i]) / n
    whole = int(sum(level.sums[i]))
    centre = round(whole / n)
    squares, columns, rows = kernels.lines(total, centre)
    sum_sq = int(squares) + 2 * centre * whole - n * centre**2
    scatter = (level.squares[i] * count - sum_sq) / (count * (count - 1) * n)  # whole numbers above: exact
    plain, d2, d4, right, below = level.pair[i]
    variance = max((scatter - float(np.var(means, ddof=1))) * n / (n - 1), 0.0)
    drift = plain / n
    spread = max(d2 / n - drift**2, 1e-12)
    excess = max(d4 / n / spread**2 - 3, 0.0) * 2 if abs(drift) < np.sqrt(spread) else 0.0
    top = max(level.tops[i])
    return Level(
        dark=key[0], exposure_s=key[1], photons=key[2], frame_means_dn=means, shape=shape, variance_dn2=variance,
        variance_error_dn2=variance * float(np.sqrt((excess / count + 2 / (count - 1)) / n)),
        spatial_dn2=(sum_sq - whole**2 / n) / (n - 1) / count**2,
        column_dn2=float(np.var(columns / (height * count), ddof=1)), row_dn2=float(np.var(rows / (width * count), ddof=1)),
        correlation_x=(right / (height * (width - 1)) - drift**2) / spread,
        correlation_y=(below / ((height - 1) * width) - drift**2) / spread,
        top_dn=int(top), at_top=level.tops[i][top] / (n * count))
