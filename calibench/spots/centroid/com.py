"""Centre of mass in the 3x3 window about the peak (thesis, section 4.3)."""

from __future__ import annotations

from ..candidates import Candidates
from ..scene import Centroids, Scene
from ._centre_of_mass import centre_of_mass


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Centre of mass of 3x3 pixels; its bias by pixel phase (up to 0.25 px) is not in the covariance."""
    return centre_of_mass(scene, candidates, 1)
