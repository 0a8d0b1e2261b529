"""Stars as point sources: what a sky frame holds beside them and a lab frame does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from .spot_shapes import SpotShapes

SAME_PX = 0.75
STAYS_IN = 1 / 3  # of the other frames: a pointing may be taken several times
MOST_STAY = 0.5
REPEATED = "at the same pixel in several frames (hot pixel, lamp)"


def moving(found: list[SpotShapes]) -> list[SpotShapes]:
    """The spots without those that stay on their pixel from frame to frame while the sky moves.

    Where more than MOST_STAY of all spots stay, the camera itself did not move, and all are kept.
    """
    trees = [cKDTree(s.detected_xy_px) if len(s.detected_xy_px) else None for s in found]
    met = [np.zeros(len(s.xy_px), int) for s in found]
    for i, one in enumerate(found):
        for j, tree in enumerate(trees):
            if j != i and tree is not None and len(one.xy_px):
                met[i] += tree.query(one.xy_px)[0] < SAME_PX
    stays = [count >= max(1.0, STAYS_IN * (len(found) - 1)) for count in met]
    if sum(s.sum() for s in stays) > MOST_STAY * sum(len(s) for s in stays):
        return found
    return [replace(one.take(~stay), rejected=one.rejected | {REPEATED: int(stay.sum())})
            for one, stay in zip(found, stays, strict=True)]
