"""Where the matched stars stood for one frame: at its own instant, from its own place, through its own air, row by row.

A series is identified in the sky of its day (or that of the frame, where air bends it); that is good to some arcseconds and all
that identification needs. The attitude is made from directions that belong to the frame.

A camera that turns at rate w (its own axes) sees a star move as dv/dt = -w x v. A row exposed dt after the time tag sees
exp(-[w]x dt) R s; handing R' exp(-[w]x dt) R s to the attitude in place of s gives R at the time tag.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import registry
from ..geometry import projection, rotation
from ..records import Identification, Observer, Rolling
from .sky_catalogue import SkyCatalogue


def as_observed(found: Identification, sky: SkyCatalogue, observer: Observer) -> Identification:
    """The identification with `direction_icrs` as this observer saw the stars."""
    directions = sky.seen_at(found.star_rows, observer)
    if observer.rolling is not None and observer.rolling.rate_rad_s.any():
        directions = _at_the_time_tag(found, directions, observer.rolling)
    return replace(found, direction_icrs=directions)


def _at_the_time_tag(found: Identification, directions: np.ndarray, rolling: Rolling) -> np.ndarray:
    """Directions (M, 3) that a camera at the time tag's attitude would have to see where the rows saw them."""
    late_s = (found.xy_px[:, 1] - rolling.middle_row) * rolling.row_time_s
    turn = rotation.matrix_from_rotvec(-late_s[:, None] * rolling.rate_rad_s)
    v = projection.unproject(found.intrinsics, found.xy_px)
    # dt is some milliseconds: an attitude that ignores it tells R well enough to turn dt's own small effect.
    straightened = np.einsum("mji,mj->mi", turn, v)
    r = registry.load("calibench.stars.attitude", "svd").attitude(straightened, directions, np.ones(len(v)))
    return np.einsum("ji,mjk,mk->mi", r, turn, directions @ r.T)
