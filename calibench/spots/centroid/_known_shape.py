"""What the fits of a known shape share: the windows of spots, without what belongs to a neighbour."""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..kernels import lose_others
from ..scene import Patches, Scene

LOST_CORE_ERROR = 0.1  # relative: how well the wings of a PSF are known, which alone are left of a saturated spot


def own_patches(scene: Scene, candidates: Candidates, radius: int) -> tuple[Patches, np.ndarray]:
    """Windows about the rough centres, NaN where another candidate is nearer; and the shape's relative misfit (N,):
    LOST_CORE_ERROR where a pixel of the 3x3 in the middle cannot be used, else 0."""
    patches = scene.patches(np.rint(candidates.xy_px).astype(np.int64), radius)
    core = patches.signal_dn[:, radius - 1:radius + 2, radius - 1:radius + 2]
    misfit = np.isnan(core).any((1, 2)) * LOST_CORE_ERROR
    lose_others(np.ascontiguousarray(candidates.xy_px, float), patches.corner_xy, patches.signal_dn)
    return patches, misfit
