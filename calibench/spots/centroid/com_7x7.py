"""Centre of mass in the 7x7 window about the peak (Hashemi et al. for wider spots)."""

from __future__ import annotations

from ..candidates import Candidates
from ..scene import Centroids, Scene
from ._centre_of_mass import centre_of_mass


def centroid(scene: Scene, candidates: Candidates) -> Centroids:
    """Centre of mass of 7x7 pixels: less bias than 3x3 for wide spots, more noise for faint ones."""
    return centre_of_mass(scene, candidates, 3)
