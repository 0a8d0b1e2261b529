"""The fast default: one compiled pass against a threshold map, then growth around each peak.

1. A pixel above its own threshold (local background + SEED_SIGMA local noise; never, where it is a defect) is looked at.
2. It is a peak where it is the highest of its 3x3, the matched filter of a faint star about it gives more than k sigma, and
   the light is not all in one pixel (a hot pixel, a particle). k follows from the asked number of false alarms a frame
   (spots/false_alarms.py).
3. The spot is what is connected to the peak above GROW_SIGMA. A second peak in it is a spot of its own where a saddle
   separates the two (both are a blend); else it is the first one's wing. Light that covers too much of the frame is no star.
"""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..false_alarms import Sensitivity
from ..room import Room
from ..threshold_map import ThresholdMap, threshold_map
from . import kernels


def detect(signal_dn: np.ndarray, noise_dn: np.ndarray, unusable: np.ndarray, sensitivity: Sensitivity) -> Candidates:
    """Spots of a background-subtracted frame (H, W), local noise (H, W), unusable pixels (H, W) bool."""
    thresholds = threshold_map(np.where(unusable, np.float32(np.nan), np.float32(0)), noise_dn, np.float32)
    return candidates_on(np.ascontiguousarray(signal_dn, np.float32), thresholds, sensitivity.k_on(thresholds))


def candidates_on(data: np.ndarray, thresholds: ThresholdMap, k_sigma: float, *, drift: np.ndarray | None = None,
                  gain_dn_per_e: float = 0.0, room: Room | None = None) -> Candidates:
    """Spots of a frame (H, W) of the threshold map's type, brightest first.

    drift: the sky's change since the map was made, per cell, in sigma. gain_dn_per_e: for the shot noise of a saddle.
    room: of a series, to save the making.
    """
    room = Room(data.shape) if room is None else room
    scene = (data, thresholds.expected_dn, thresholds.noise_dn, thresholds.no_drift if drift is None else drift)
    count = kernels.scan(data, thresholds.seed_dn, thresholds.lowest_dn, *scene[1:3],
                         thresholds.coarse_dn, scene[3], float(k_sigma), room.above, room.eight, room.waiting, room.peaks)
    if count == 0:
        return Candidates.none()
    peaks = room.peaks[np.argsort(-room.peaks[:count, 2], kind="stable")]
    found = np.zeros((count, kernels.COLUMNS))
    count = kernels.grow(*scene, peaks, float(gain_dn_per_e), room.labels, room.clear(), room.stack,
                         np.zeros(count, np.int64), np.zeros(count), found)
    found = found[:count]
    return Candidates(xy_px=found[:, :2].copy(), peak_xy=found[:, 6:8].astype(np.int64), peak_dn=found[:, 2],
                      flux_dn=found[:, 3], pixels=found[:, 4].astype(int), elongation=found[:, 5], blend=found[:, 9] > 0)
