"""Checks on a series as a whole: frames of one kind of camera setting, and no automatic exposure or gain at work.

A single frame cannot show these; a measurement that mixes them gives figures that look sound and are not.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from ..errors import BadInput
from ..records import Frame
from .alignment import WORD_BITS, empty_low_bits

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


def check_series(frames: Sequence[Frame]) -> list[Frame]:
    """The frames of one series after all checks, in order; duplicates carry a note.

    Raises:
        BadInput: mixed settings (`require_alike`) or an automatic at work (`refuse_automatic`).
    """
    frames = _with_range_seen(_aligned_alike(frames))
    require_alike(frames)
    refuse_automatic(frames)
    return _duplicates_noted(frames)


def require_alike(frames: Iterable[Frame]) -> None:
    """Refuse a series of mixed image sizes, number types, bit depths, cameras, gain settings or Bayer patterns.

    A camera, gain or pattern that a frame does not state mixes with any.

    Raises:
        BadInput: with a table of the groups found.
    """
    groups: dict[tuple, list[str]] = defaultdict(list)
    for frame in frames:
        key = ("{} x {}".format(*frame.image_size_px), str(frame.data.dtype), frame.bit_depth, frame.camera,
               frame.gain_setting, frame.bayer_pattern)
        groups[key].append(frame.name)
    columns = ("size", "type", "bits", "camera", "gain", "Bayer")
    stated = [{key[i] for key in groups if key[i] is not None} for i in range(len(columns))]
    mixed = [column for column, values in zip(columns, stated, strict=True) if len(values) > 1]
    if mixed:
        rows = [("frames", *columns, "first")]
        rows += [(str(len(names)), *("-" if v is None else str(v) for v in key), names[0])
                 for key, names in groups.items()]
        raise BadInput(f"the frames are mixed in {', '.join(mixed)}:\n{_table(rows)}",
                       mend="give frames of one camera and one setting; measure each group by itself")


def refuse_automatic(frames: Sequence[Frame]) -> None:
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
        levels_dn = [float(frame.data.mean()) for frame in stated]
        unsaturated = [(frame, dn) for frame, dn in zip(stated, levels_dn, strict=True) if dn < SATURATED * white_dn]
        _refuse_steps(kind, unsaturated)
        if kind == "flat":
            _refuse_constant_level(unsaturated)


def duplicates(frames: Iterable[Frame]) -> list[tuple[Frame, Frame]]:
    """(frame, earlier frame) pairs whose files are the same byte for byte."""
    first: dict[str, Frame] = {}
    pairs = []
    for frame in frames:
        if frame.sha256 and first.setdefault(frame.sha256, frame) is not frame:
            pairs.append((frame, first[frame.sha256]))
    return pairs


def _refuse_steps(kind: str, frames_and_levels: Sequence[tuple[Frame, float]]) -> None:
    alike: dict[tuple, list[tuple[Frame, float]]] = defaultdict(list)
    for frame, level_dn in frames_and_levels:
        warmth = round(frame.temperature_c) if kind == "dark" and frame.temperature_c is not None else None
        alike[float(f"{frame.exposure_s:.3g}"), warmth].append((frame, level_dn))
    for (exposure_s, _), group in alike.items():
        levels_dn = np.array([level_dn for _, level_dn in group])
        middle_dn = float(np.median(levels_dn))
        kept = np.argsort(np.abs(levels_dn - middle_dn))[: len(group) - (len(group) >= FRAMES_FOR_ONE_ODD)]
        low, high = min(kept, key=levels_dn.__getitem__), max(kept, key=levels_dn.__getitem__)
        allowed_dn = LEVEL_SPREAD_MAX * abs(middle_dn)
        if kind == "dark":
            allowed_dn = max(allowed_dn, DARK_SPREAD_SIGMA * _noise_dn(group[low][0]))
        if levels_dn[high] - levels_dn[low] > allowed_dn:
            warming = ", or a warming sensor whose temperature no frame states" if kind == "dark" else ""
            raise BadInput(
                f"{len(group)} {kind}s state one exposure ({exposure_s:g} s), but their mean levels run from "
                f"{levels_dn[low]:.1f} DN ({group[low][0].name}) to {levels_dn[high]:.1f} DN ({group[high][0].name}): "
                f"automatic exposure or gain at work{warming}",
                mend="switch the automatics off and take the series again, or state each frame's own exposure")


def _refuse_constant_level(frames_and_levels: Sequence[tuple[Frame, float]]) -> None:
    if not frames_and_levels:
        return
    by_exposure: dict[float, list[float]] = defaultdict(list)
    for frame, level_dn in frames_and_levels:
        by_exposure[frame.exposure_s].append(level_dn)
    shortest_s, longest_s = min(by_exposure), max(by_exposure)
    if longest_s < EXPOSURE_RATIO_MIN * shortest_s or longest_s == 0:
        return
    low_dn, high_dn = float(np.median(by_exposure[shortest_s])), float(np.median(by_exposure[longest_s]))
    if high_dn - low_dn < RISE_MIN * high_dn * (1 - shortest_s / longest_s):
        raise BadInput(
            f"the flats state exposures from {shortest_s:g} s to {longest_s:g} s, but their level stays "
            f"({low_dn:.1f} DN and {high_dn:.1f} DN): automatic exposure or gain at work, wrong exposures, or no light",
            mend="switch the automatics off and take the series again")


def _white_level_seen(frames: Iterable[Frame]) -> float:
    """The white level; where the container is wider than the values seen in the whole series, the next full power of two."""
    frames = list(frames)
    largest = max(int(frame.data.max()) for frame in frames)
    return min(frames[0].white_level_dn, 2.0**largest.bit_length() - 1)


def _noise_dn(frame: Frame) -> float:
    """Robust scatter of the pixels (1.4826 MAD), at least one step of the converter."""
    sample = frame.data[::4, ::4].astype(np.float32)
    return max(1.0, 1.4826 * float(np.median(np.abs(sample - np.median(sample)))))


def _with_range_seen(frames: Sequence[Frame]) -> list[Frame]:
    """Where no source states the converter's bits and light is among the frames, its range is what the brightest value needs.

    Darks alone never come near the end of the range: they keep the guess, and are judged without it.
    """
    if not frames or not all(frame.range_assumed for frame in frames) or all(frame.kind == "dark" for frame in frames):
        return list(frames)
    largest = int(max(frame.data.max() for frame in frames))
    depth = max(SMALLEST_DEPTH, 2 * -(-largest.bit_length() // 2))  # converters have an even number of bits
    note = f"{depth} bits assumed: the largest value of the series is {largest}; state bit_depth in a sidecar to be sure"
    return [dataclasses.replace(frame, bit_depth=depth, white_level_dn=2.0**depth - 1, notes=(*_without_guess(frame), note))
            for frame in frames]


def _without_guess(frame: Frame) -> tuple[str, ...]:
    return tuple(note for note in frame.notes if "bits assumed" not in note)


def _aligned_alike(frames: Sequence[Frame]) -> list[Frame]:
    """Shift the frames too poor in values to show by themselves that they are left-aligned like the others.

    A black frame of a few distinct values proves nothing alone; beside frames of the same camera that do, it does.
    """
    depths = {frame.bit_depth for frame in frames if any("left-aligned" in note for note in frame.notes)}
    if len(depths) != 1:
        return list(frames)
    depth = depths.pop()
    shift = WORD_BITS - depth
    return [_shifted(frame, shift) if frame.bit_depth == WORD_BITS and frame.data.dtype == np.uint16
            and (empty_low_bits(frame.data) >= shift or not frame.data.any()) else frame for frame in frames]


def _shifted(frame: Frame, shift: int) -> Frame:
    depth = WORD_BITS - shift
    return dataclasses.replace(frame, data=frame.data >> shift, bit_depth=depth, white_level_dn=float(2**depth - 1),
                               notes=(f"left-aligned {depth}-bit data like the rest of the series; shifted right by "
                                      f"{shift} bits",))


def _duplicates_noted(frames: Sequence[Frame]) -> list[Frame]:
    notes = {id(frame): f"the file is the same, byte for byte, as {earlier.name}"
             for frame, earlier in duplicates(frames)}
    return [dataclasses.replace(frame, notes=(*frame.notes, notes[id(frame)])) if id(frame) in notes else frame
            for frame in frames]


def _table(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  " + "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
