"""Checks on a series as a whole: frames of one kind of camera setting, and no automatic exposure or gain at work.

A single frame cannot show these; a measurement that mixes them gives figures that look sound and are not. The checks work on
what was seen of the frames, so that no pixels are held for them.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from ..errors import BadInput
from .alignment import WORD_BITS
from .frame_seen import FrameSeen

# Levels of frames taken alike may differ by this much (lamp drift, warming); a third of a stop of exposure is 26 %.
LEVEL_SPREAD_MAX = 0.2
DARK_SPREAD_SIGMA = 5.0
# With exposures this far apart a flat's level must rise by at least this part of the rise that light would give.
EXPOSURE_RATIO_MIN = 1.5
RISE_MIN = 0.1
SATURATED = 0.95
# From this many frames on, one odd frame is no sign of an automatic: the measurement rejects it by its name.
FRAMES_FOR_ONE_ODD = 5
SMALLEST_DEPTH = 8
COLUMNS = ("size", "type", "bits", "camera", "gain", "Bayer")


def check_series(frames: Sequence[FrameSeen]) -> list[FrameSeen]:
    """The frames of one series after all checks, in order: depths and white levels settled, duplicates noted.

    Raises:
        BadInput: mixed settings (`Groups.require_one`) or an automatic at work (`refuse_automatic`).
    """
    frames = _with_range_seen([aligned_alike(frame, frames) for frame in frames])
    groups, first = Groups(), {}
    for frame in frames:
        groups.add(frame)
    groups.require_one()
    refuse_automatic(frames)
    return [duplicate_noted(frame, first) for frame in frames]


class Groups:
    """Takes frames one by one and sorts them by image size, number type, bit depth, camera, gain setting and Bayer pattern.

    A camera, gain or pattern that a frame does not state goes with any.
    """

    def __init__(self) -> None:
        self._names: dict[tuple, list[str]] = defaultdict(list)
        self._stated: list[set] = [set() for _ in COLUMNS]

    def add(self, frame: FrameSeen) -> None:
        """Put a frame into its group."""
        key = ("{} x {}".format(*frame.image_size_px), frame.dtype, frame.bit_depth, frame.camera, frame.gain_setting,
               frame.bayer_pattern)
        self._names[key].append(frame.name)
        for values, value in zip(self._stated, key, strict=True):
            if value is not None:
                values.add(value)

    @property
    def mixed(self) -> list[str]:
        """In what the frames differ; nothing where they are one series."""
        return [column for column, values in zip(COLUMNS, self._stated, strict=True) if len(values) > 1]

    def require_one(self) -> None:
        """Refuse a series of several groups.

        Raises:
            BadInput: with a table of the groups.
        """
        if self.mixed:
            rows = [("frames", *COLUMNS, "first")]
            rows += [(str(len(names)), *("-" if v is None else str(v) for v in key), names[0])
                     for key, names in self._names.items()]
            raise BadInput(f"the frames are mixed in {', '.join(self.mixed)}:\n{_table(rows)}",
                           mend="give frames of one camera and one setting; measure each group by itself")


def refuse_automatic(frames: Sequence[FrameSeen]) -> None:
    """Refuse darks or flats whose levels do not go with their stated exposures. Frames without an exposure claim nothing.

    Two signs: frames of one stated exposure (darks: and temperature) whose levels differ by more than LEVEL_SPREAD_MAX;
    flats whose level stays although their stated exposures differ by EXPOSURE_RATIO_MIN or more.

    Raises:
        BadInput: with the levels and exposures that show it.
    """
    for kind in ("dark", "flat"):
        stated = [frame for frame in frames if frame.kind == kind and frame.exposure_s is not None]
        if len(stated) < 2:
            continue
        white_dn = _white_level_seen(stated)
        unsaturated = [frame for frame in stated if frame.level_dn < SATURATED * white_dn]
        _refuse_steps(kind, unsaturated)
        if kind == "flat":
            _refuse_constant_level(unsaturated)


def _refuse_steps(kind: str, frames: Sequence[FrameSeen]) -> None:
    alike: dict[tuple, list[FrameSeen]] = defaultdict(list)
    for frame in frames:
        warmth = round(frame.temperature_c) if kind == "dark" and frame.temperature_c is not None else None
        alike[float(f"{frame.exposure_s:.3g}"), warmth].append(frame)
    for (exposure_s, _), group in alike.items():
        levels_dn = np.array([frame.level_dn for frame in group])
        middle_dn = float(np.median(levels_dn))
        kept = np.argsort(np.abs(levels_dn - middle_dn))[: len(group) - (len(group) >= FRAMES_FOR_ONE_ODD)]
        low, high = min(kept, key=levels_dn.__getitem__), max(kept, key=levels_dn.__getitem__)
        allowed_dn = LEVEL_SPREAD_MAX * abs(middle_dn)
        if kind == "dark":
            allowed_dn = max(allowed_dn, DARK_SPREAD_SIGMA * max(1.0, group[low].noise_dn))
        if levels_dn[high] - levels_dn[low] > allowed_dn:
            warming = ", or a warming sensor whose temperature no frame states" if kind == "dark" else ""
            raise BadInput(
                f"{len(group)} {kind}s state one exposure ({exposure_s:g} s), but their mean levels run from "
                f"{levels_dn[low]:.1f} DN ({group[low].name}) to {levels_dn[high]:.1f} DN ({group[high].name}): "
                f"automatic exposure or gain at work{warming}",
                mend="switch the automatics off and take the series again, or state each frame's own exposure")


def _refuse_constant_level(frames: Sequence[FrameSeen]) -> None:
    if not frames:
        return
    by_exposure: dict[float, list[float]] = defaultdict(list)
    for frame in frames:
        by_exposure[frame.exposure_s].append(frame.level_dn)
    shortest_s, longest_s = min(by_exposure), max(by_exposure)
    if longest_s < EXPOSURE_RATIO_MIN * shortest_s or longest_s == 0:
        return
    low_dn, high_dn = float(np.median(by_exposure[shortest_s])), float(np.median(by_exposure[longest_s]))
    if high_dn - low_dn < RISE_MIN * high_dn * (1 - shortest_s / longest_s):
        raise BadInput(
            f"the flats state exposures from {shortest_s:g} s to {longest_s:g} s, but their level stays "
            f"({low_dn:.1f} DN and {high_dn:.1f} DN): automatic exposure or gain at work, wrong exposures, or no light",
            mend="switch the automatics off and take the series again; or were the folders of darks and flats swapped?")


def _white_level_seen(frames: Sequence[FrameSeen]) -> float:
    """The white level; where the container is wider than the values seen in the whole series, the next full power of two."""
    largest = max(int(frame.largest_dn) for frame in frames)
    return min(frames[0].white_level_dn, 2.0**largest.bit_length() - 1)


def _with_range_seen(frames: Sequence[FrameSeen]) -> list[FrameSeen]:
    """Where no source states the converter's bits and light is among the frames, its range is what the brightest value needs.

    Darks alone never come near the end of the range: they keep the guess, and are judged without it.
    """
    if not frames or not all(frame.range_assumed for frame in frames) or all(frame.kind == "dark" for frame in frames):
        return list(frames)
    largest = int(max(frame.largest_dn for frame in frames))
    depth = max(SMALLEST_DEPTH, 2 * -(-largest.bit_length() // 2))  # converters have an even number of bits
    note = f"{depth} bits assumed: the largest value of the series is {largest}; state bit_depth in a sidecar to be sure"
    return [dataclasses.replace(frame, bit_depth=depth, white_level_dn=2.0**depth - 1, notes=(*_without_guess(frame), note))
            for frame in frames]


def _without_guess(frame: FrameSeen) -> tuple[str, ...]:
    return tuple(note for note in frame.notes if "bits assumed" not in note)


def aligned_alike(frame: FrameSeen, others: Iterable[FrameSeen]) -> FrameSeen:
    """The frame shifted where it is too poor in values to show by itself that it is left-aligned like the others.

    A black frame of a few distinct values proves nothing alone; beside frames of the same camera that do, it does.
    """
    if not frame.left_bits:
        return frame
    depths = {other.bit_depth for other in others if any("left-aligned" in note for note in other.notes)}
    shift = WORD_BITS - depths.pop() if len(depths) == 1 else WORD_BITS + 1
    if frame.left_bits < shift:
        return frame
    return frame.shifted(shift, f"left-aligned {WORD_BITS - shift}-bit data like the rest of the series; shifted right by "
                                f"{shift} bits")


def duplicate_noted(frame: FrameSeen, first: dict[str, str]) -> FrameSeen:
    """The frame, with a note where its file is the same byte for byte as an earlier one. first: name by sha256, kept here."""
    if not frame.sha256 or frame.sha256 not in first:
        first[frame.sha256] = frame.name
        return frame
    return dataclasses.replace(frame, notes=(*frame.notes, f"the file is the same, byte for byte, as {first[frame.sha256]}"))


def _table(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
