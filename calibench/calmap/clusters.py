"""Defects that touch: the flag `cluster`."""

from __future__ import annotations

import numpy as np

from ..records import DEFECT_FLAGS, UNUSABLE


def with_clusters(defects: np.ndarray) -> np.ndarray:
    """The flags (H, W) uint16 with `cluster` set anew: on each UNUSABLE pixel with another one among its 8 neighbours.

    The flag informs: a pixel is blinded by what it carries besides. Interpolation is worse inside a cluster.
    """
    bad = np.pad((defects & UNUSABLE) != 0, 1)
    in_row = bad[:, :-2] | bad[:, 2:]  # left and right
    across = in_row | bad[:, 1:-1]
    near = across[:-2] | across[2:] | in_row[1:-1]
    cluster = np.uint16(DEFECT_FLAGS["cluster"])
    return np.where(bad[1:-1, 1:-1] & near, defects | cluster, defects & ~cluster)
