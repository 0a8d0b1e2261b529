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
from .._frames.glance import glance
from . import kernels
from .crosstalk import neighbours

OPEN_BYTES = 60e6  # of sum images at a time; a level that comes again after it was given up is a level of its own
SAME_LIGHT = 0.01  # frames of one exposure whose means differ by more are different levels
SAME_LIGHT_DN = 1.0
PLANES = {"R": "r", "B": "b"}


@dataclass(frozen=True, kw_only=True)
class Level:
    """One plane of one level of light (a mosaic has four planes, else there is one).

    frame_means_dn: (L,). variance_dn2: temporal, common drift taken off (R4: the pair formula), with its 1-sigma error.
    spatial_dn2, column_dn2, row_dn2: variance of the mean image over its pixels, its column means, its row means, as measured.
    correlation: (6,) of the difference of the first two frames with its neighbours at `crosstalk.STEPS`; pair_variance_dn2: the
    temporal variance of these two. top_dn, at_top: largest value and the share of pixels that have it. pixels: how many;
    shape: (H, W) of the plane.
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
    correlation: np.ndarray
    pair_variance_dn2: float
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
    """Sums of the frames of each plane (H, W) of one level, and that level."""

    totals: tuple[np.ndarray, ...]
    levels: tuple[Level, ...]


@dataclass
class _Open:
    """One plane of a level while its frames come in: the frames themselves up to two, then their sum."""

    frames: list[np.ndarray] = field(default_factory=list)
    total: np.ndarray | None = None
    sums: list[int] = field(default_factory=list)
    squares: int = 0
    tops: dict[int, int] = field(default_factory=dict)
    pair: tuple = ()
    correlation: np.ndarray | None = None

    def add(self, plane: np.ndarray, maximum: int, count: int) -> None:
        """Add a frame's plane, whose maximum so many pixels have."""
        self.tops[maximum] = self.tops.get(maximum, 0) + count
        self.frames.append(plane)
        if len(self.frames) == 2 and not self.pair:
            self.pair = kernels.pair(*self.frames)
            self.correlation = neighbours(*self.frames, _nearest(self.pair))
        if len(self.frames) > 2 or self.total is not None:
            self._pile()

    def summed(self) -> np.ndarray:
        """(H, W) uint32 sum of the frames."""
        if self.total is None:
            self._pile()
        return self.total

    @property
    def held_bytes(self) -> int:
        return sum(f.nbytes for f in self.frames) + (0 if self.total is None else self.total.nbytes)

    def _pile(self) -> None:
        if self.total is None:
            self.total = np.zeros(self.frames[0].shape, np.uint32)
        for frame in self.frames:
            plain, squares = kernels.add(frame, self.total)
            self.sums.append(int(plain))
            self.squares += int(squares)
        self.frames.clear()


class Levels:
    """Takes frames one by one; `levels`, `stacks` and `single` are complete after `close`.

    levels: for each plane, all levels of two frames or more. stacks: of dark (True) and lit frames. single: files of levels
    with one frame only, single_lit: how many of these are light.
    """

    def __init__(self, bayer_pattern: str | None):
        self._places = _places(bayer_pattern)
        self._open: OrderedDict[tuple, list[_Open]] = OrderedDict()
        self._files: dict[tuple, list[str]] = {}
        self._marks: dict[tuple, float] = {}
        self.levels: dict[str, list[Level]] = {name: [] for name in self._places}
        self.stacks: dict[bool, Stack] = {}
        self.single: list[str] = []
        self.single_lit = 0

    def add(self, frame: Frame, photons: float | None) -> None:
        """Add a frame, dark where its kind says so. photons: that a pixel receives in this exposure; None: not stated.

        Raises:
            BadInput: its values are no whole DN of 16 bits.
        """
        seen = glance(frame)
        if seen.values.dtype != np.uint16:
            raise BadInput(f"pixel values from {seen.smallest} to {seen.largest} DN do not fit 16 bits",
                           file=frame.file or None, mend="give frames as the camera made them, not scaled or subtracted copies")
        key = self._key(frame, photons, seen.level_dn)
        planes = self._open.setdefault(key, [_Open() for _ in self._places])
        self._open.move_to_end(key)
        self._files.setdefault(key, []).append(frame.file or frame.name)
        for level, place in zip(planes, self._places.values(), strict=True):
            plane = np.ascontiguousarray(seen.values[place]).view()
            plane.flags.writeable = False  # one compiled form serves planes and whole frames
            level.add(plane, *((seen.largest, seen.at_largest) if len(planes) == 1 else kernels.top(plane)))
        self._give_up_oldest(frame.white_level_dn)

    def close(self, white_level_dn: float) -> None:
        """No more frames."""
        for key in list(self._open):
            self._close(key, white_level_dn)

    def _key(self, frame: Frame, photons: float | None, mark_dn: float) -> tuple:
        """Of the open level that the frame belongs to, or a new one. Where nothing tells lights of one exposure apart, the mean
        does."""
        alike = (frame.kind == "dark", frame.exposure_s, photons)
        if alike[0] or photons is not None:
            return *alike, 0
        for key, theirs in self._marks.items():
            if key[:3] == alike and key in self._open and abs(theirs - mark_dn) <= max(SAME_LIGHT * theirs, SAME_LIGHT_DN):
                return key
        key = (*alike, len(self._marks))
        self._marks[key] = mark_dn
        return key

    def _give_up_oldest(self, white_level_dn: float) -> None:
        held = sum(level.held_bytes for planes in self._open.values() for level in planes)
        for key in [k for k in self._open if len(self._files[k]) > 1][:-1]:
            if held <= OPEN_BYTES:
                return
            held -= sum(level.held_bytes for level in self._open[key])
            self._close(key, white_level_dn)

    def _close(self, key: tuple, white_level_dn: float) -> None:
        planes, files = self._open.pop(key), self._files.pop(key)
        if len(files) < 2:
            self.single += files
            self.single_lit += not key[0]
            return
        found = tuple(_figures(level, key) for level in planes)
        for figures, name in zip(found, self._places, strict=True):
            self.levels[name].append(figures)
        kept = self.stacks.get(key[0])
        if kept is None or _worth(found, white_level_dn) > _worth(kept.levels, white_level_dn):
            self.stacks[key[0]] = Stack(totals=tuple(level.summed() for level in planes), levels=found)


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


def _worth(planes: tuple[Level, ...], white_level_dn: float) -> tuple:
    """What makes a good stack: lit to about half of the range, many frames, then the nearest to half."""
    off = abs(np.mean([p.mean_dn for p in planes]) / white_level_dn - 0.5)
    dark = planes[0].dark
    return (dark or off < 0.25, planes[0].count, 0.0 if dark else -off)


def _nearest(pair: tuple) -> tuple[float, float]:
    """Correlations of a pair's difference with its right and its lower neighbour, from its sums."""
    plain, d2, _, right, below, _, columns, rows = pair
    height, width = len(rows), len(columns)
    drift = plain / (height * width)
    spread = max(d2 / (height * width) - drift**2, 1e-12)
    return (right / (height * (width - 1)) - drift**2) / spread, (below / ((height - 1) * width) - drift**2) / spread


def _figures(level: _Open, key: tuple) -> Level:
    plain, d2, d4, _, _, both, columns, rows = level.pair
    height, width = len(rows), len(columns)
    n, count = height * width, 2
    if level.total is None:
        whole = float(rows.sum())
        means = np.array([whole - plain, whole + plain]) / (2 * n)
        scatter, sum_sq = d2 / (2 * n), both
    else:
        count, whole = len(level.sums), sum(level.sums)
        means = np.array(level.sums) / n
        centre = round(whole / n)
        squares, columns, rows = kernels.lines(level.total, centre)
        sum_sq = int(squares) + 2 * centre * whole - n * centre**2
        scatter = (level.squares * count - sum_sq) / (count * (count - 1) * n)  # whole numbers so far: exact
    variance = max((scatter - float(np.var(means, ddof=1))) * n / (n - 1), 0.0)
    drift = plain / n
    spread = max(d2 / n - drift**2, 1e-12)
    excess = 2 * max(d4 / n / spread**2 - 3, 0.0) if abs(drift) < np.sqrt(spread) else 0.0
    top = max(level.tops)
    return Level(
        dark=key[0], exposure_s=key[1], photons=key[2], frame_means_dn=means, shape=(height, width), variance_dn2=variance,
        variance_error_dn2=variance * float(np.sqrt((excess / count + 2 / (count - 1)) / n)),
        spatial_dn2=max(float(sum_sq / n - (whole / n) ** 2), 0.0) / count**2,
        column_dn2=float(np.var(columns / (height * count))), row_dn2=float(np.var(rows / (width * count))),
        correlation=level.correlation, pair_variance_dn2=spread / 2 * n / (n - 1), top_dn=int(top),
        at_top=level.tops[top] / (n * count))
