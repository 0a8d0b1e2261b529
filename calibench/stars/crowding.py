"""Crowding: how far the light of its neighbours pulls a star's spot away from where the catalogue has the star.

Two stars closer than their images are wide stand in one spot at their centre of light; farther apart each has its own window,
and the pull fades. With s the separation and f the neighbour's part of their light, the pull is

    s f exp(-(s / (FADE sigma))^4),        sigma the PSF's width

(fitted on rendered pairs of 0.9 px: 0.97, 0.87, 0.50, 0.03 of s f at 0.3, 1.8, 2.8, 4.5 px). It belongs to a pair, not to a
spot, and its centroid's covariance cannot know it: it is added as a variance, alike along both axes.
"""

from __future__ import annotations

import numpy as np

from ..records import Identification, PsfMap
from ..spots.psf import moments_at
from .lost_in_space import LostInSpace
from .sky_catalogue import SkyCatalogue

FADE = 3.3
FARTHEST = 1.6 * FADE  # sigma; beyond, less than 0.2 % of the pull is left
UNKNOWN_SIGMA_PX = 1.0
STEP = 0.1  # widths that differ by less share one table


def pull2_rad2(sky: SkyCatalogue, sigma_rad: float) -> np.ndarray:
    """(N,) squared pull, rad^2, on every star of a sky seen with a PSF of that width; several neighbours' squares add up."""
    pairs = sky.tree.query_pairs(2 * np.sin(FARTHEST * sigma_rad / 2), output_type="ndarray")
    apart = np.linalg.norm(sky.directions[pairs[:, 0]] - sky.directions[pairs[:, 1]], axis=1)
    fades, out = apart * np.exp(-(apart / (FADE * sigma_rad)) ** 4), np.zeros(len(sky.directions))
    for one, other in ((0, 1), (1, 0)):
        fainter = sky.magnitude[pairs[:, other]] - sky.magnitude[pairs[:, one]]
        np.add.at(out, pairs[:, one], (fades / (1 + 10 ** (0.4 * fainter))) ** 2)
    return out


def with_crowding(found: Identification, finder: LostInSpace, psf: PsfMap | None) -> np.ndarray:
    """Covariance (M, 2, 2), px^2, of a solved frame's matched spots with the pull of their stars' neighbours."""
    sigma_px, focal_px = UNKNOWN_SIGMA_PX if psf is None else _sigma_px(psf), found.intrinsics.fx_px
    step = round(np.log(sigma_px / focal_px) / STEP)
    key = "crowding", step
    if key not in finder.tables:
        finder.tables[key] = pull2_rad2(finder.sky, float(np.exp(step * STEP)))
    pull2_px2 = finder.tables[key][found.star_rows] * focal_px**2
    return found.covariance_px2 + pull2_px2[:, None, None] * np.eye(2)


def _sigma_px(psf: PsfMap) -> float:
    """The PSF's width in the middle of the image, pixel included."""
    w, h = psf.image_size_px
    return float(np.sqrt(moments_at(psf, np.array([[(w - 1) / 2, (h - 1) / 2]]))[0, :2].mean() + 1 / 12))
