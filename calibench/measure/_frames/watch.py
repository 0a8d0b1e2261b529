"""What sets single frames apart from those taken just before and after: level, light across the field, bands of rows.

A frame is compared with its two nearest frames of the same kind, exposure and level, and counts as odd by the smaller
difference: a good frame beside an odd one agrees with its other neighbour, and slow drift is no oddity. Differences are of
block means, whose noise is read off neighbouring blocks.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...records import Frame
from .glance import Glance

SAME_LEVEL = 0.05  # frames further apart in level are not taken alike
BEYOND_NOISE = 6.0
LEAST_FLAT, LEAST_DARK_DN = 0.005, 0.5  # what matters: this part of a flat's level, so many DN of a dark
SIGNS = {"level": "a level that jumps by {}: flicker, or another exposure",
         "gradient": "a gradient of {} that their neighbours do not have: light comes in, or the lamp moved",
         "bands": "bands of rows, {} (1 sigma): light that flickers within the exposure, or unsteady power"}


@dataclass
class _Group:
    """Frames of one kind and exposure: names, levels, the last two block images, differences to the last and last but one."""

    names: list[str] = field(default_factory=list)
    levels_dn: list[float] = field(default_factory=list)
    blocks: list[np.ndarray] = field(default_factory=list)
    to_last: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    to_before: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))


class Watch:
    """Takes frames one by one; `warnings` names the odd ones."""

    def __init__(self) -> None:
        self._groups: dict[tuple, _Group] = defaultdict(_Group)

    def take(self, frame: Frame, seen: Glance) -> None:
        """Compare a frame with the two of its group before it."""
        group = self._groups[frame.kind, frame.exposure_s]
        for name in ("gradient", "bands"):
            group.to_last[name].append(np.inf)
            group.to_before[name].append(np.inf)
        for store, i in ((group.to_last, -1), (group.to_before, -2)):
            if len(group.blocks) >= -i:
                found = _difference(seen.blocks_dn, group.blocks[i], frame.kind == "flat")
                for name, value in found.items():
                    store[name][-1] = value
        group.names.append(frame.name)
        group.levels_dn.append(seen.level_dn)
        group.blocks = [*group.blocks[-1:], seen.blocks_dn]

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each sign in each group of three frames or more, with the first such frame."""
        out = []
        for (kind, exposure_s), group in self._groups.items():
            odd = {"level": _jumps(group.levels_dn, kind == "flat")}
            odd |= {name: _smaller(group.to_last[name], group.to_before[name]) for name in ("gradient", "bands")}
            for name, size in odd.items():
                found = np.flatnonzero(np.isfinite(size) & (size > 0))
                if len(group.names) >= 3 and len(found):
                    worst = size[found].max()
                    amount = f"up to {100 * worst:.2g} %" if kind == "flat" else f"up to {worst:.2g} DN"
                    at = "" if exposure_s is None else f" of {exposure_s:g} s"
                    out.append(f"{_listed([group.names[i] for i in found])} ({len(found)} of {len(group.names)} {kind}s{at}): "
                               f"{SIGNS[name].format(amount)}")
        return tuple(out)


def _difference(mine: np.ndarray, theirs: np.ndarray, lit: bool) -> dict[str, float]:
    """Sizes of gradient and bands in the difference of two block images, in DN or (lit) as part of the level; 0: too small to
    tell or to matter; inf: no frames taken alike."""
    level = float(mine.mean())
    if abs(level - theirs.mean()) > max(SAME_LEVEL * abs(level), 2 * LEAST_DARK_DN) or mine.shape != theirs.shape:
        return {}
    e = mine / level - theirs / theirs.mean() if lit else mine - level - (theirs - theirs.mean())
    rows, columns = e.shape
    if min(rows, columns) < 4:
        return {"gradient": 0.0, "bands": 0.0}
    noise = 1.4826 / np.sqrt(2) * float(np.median(np.abs(np.diff(e, axis=1))))
    y, x = np.linspace(-0.5, 0.5, rows), np.linspace(-0.5, 0.5, columns)
    slope_y, slope_x = (e.mean(axis=1) @ y) / (y @ y), (e.mean(axis=0) @ x) / (x @ x)
    bands = float(np.std(e.mean(axis=1) - slope_y * y))
    gradient = abs(slope_x) + (abs(slope_y) if abs(slope_y) / np.sqrt(12) > bands else 0.0)  # bands may tilt by chance
    least = LEAST_FLAT if lit else LEAST_DARK_DN
    error = noise / np.sqrt(e.size)
    return {"gradient": gradient if gradient > max(2 * least, BEYOND_NOISE * np.sqrt(24) * error) else 0.0,
            "bands": bands if bands > max(least, BEYOND_NOISE * np.sqrt(rows) * error) else 0.0}


def _smaller(to_last: Sequence[float], to_before: Sequence[float]) -> np.ndarray:
    """For each frame the smaller of its differences to two neighbours; at the ends to the next two."""
    last, before = np.array(to_last), np.array(to_before)
    after = np.append(last[1:], before[-1])
    if len(last) > 2:
        last[0] = before[2]
    return np.minimum(last, after)


def _jumps(levels_dn: Sequence[float], lit: bool) -> np.ndarray:
    """For each frame how far its level lies from those before and after, where these agree; DN or (lit) part of the level."""
    levels = np.array(levels_dn)
    out = np.zeros(len(levels))
    if len(levels) < 3:
        return out
    before, after = levels[:-2], levels[2:]
    middle = (before + after) / 2
    jump = np.abs(levels[1:-1] - middle)
    least = 2 * LEAST_FLAT * np.abs(middle) if lit else np.full(len(middle), LEAST_DARK_DN)
    usual = 1.4826 * float(np.median(jump))
    odd = (jump > np.maximum(least, BEYOND_NOISE * usual)) & (np.abs(before - after) < jump / 2)
    out[1:-1] = np.where(odd, jump / (np.abs(middle) if lit else 1), 0)
    return out


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
