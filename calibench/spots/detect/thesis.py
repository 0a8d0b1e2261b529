"""The thesis detector: one global threshold, a 3x3 climb, a count of lit pixels (COTS CMOS star imager, section 4.2).

1. Threshold T = frame mean + k sigma, both of the whole frame.
2. From every other row and column, a pixel above T climbs to the brightest of its 3x3 neighbours until it is the brightest.
3. A star has 4 to 9 pixels above T in the 3x3 around its peak, so that a single hot pixel is not one.
"""

from __future__ import annotations

import numpy as np

from ..candidates import Candidates
from ..false_alarms import Sensitivity

OWN_K_SIGMA = 5.0  # of the frame, whatever rate is asked: the scatter of a scene promises none
FEWEST_PIXELS = 4


def detect(signal_dn: np.ndarray, noise_dn: np.ndarray, unusable: np.ndarray, sensitivity: Sensitivity) -> Candidates:
    """Spots of a background-subtracted frame (H, W). `noise_dn` is not used: the thesis takes the frame's own sigma."""
    image = np.where(unusable, 0.0, signal_dn)
    h, w = image.shape
    if min(h, w) < 3:
        return Candidates.none()
    threshold = image.mean() + (sensitivity.k_sigma or OWN_K_SIGMA) * image.std()
    rows, columns = np.nonzero(image[1:-1:2, 1:-1:2] > threshold)
    y, x = 2 * rows + 1, 2 * columns + 1
    offsets = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    while True:  # all climbers at once; each step moves to a strictly brighter pixel, so this ends
        around = np.stack([image[y + dy, x + dx] for dy, dx in offsets])
        best = np.where(around.max(0) > image[y, x], around.argmax(0), 4)
        step_y, step_x = np.array(offsets)[best].T if len(best) else (0, 0)
        next_y, next_x = np.clip(y + step_y, 1, h - 2), np.clip(x + step_x, 1, w - 2)
        if np.array_equal(next_y, y) and np.array_equal(next_x, x):
            break
        y, x = next_y, next_x
    peaks = np.unique(y * w + x)
    y, x = np.divmod(peaks, w)
    window = np.stack([image[y + dy, x + dx] for dy, dx in offsets])  # (9, N)
    lit = np.where(window > threshold, window, 0.0)
    keep = (lit > 0).sum(0) >= FEWEST_PIXELS
    y, x, lit = y[keep], x[keep], lit[:, keep]
    flux = lit.sum(0)
    dy, dx = np.array(offsets, float).T
    xy = np.stack([x + dx @ lit / flux, y + dy @ lit / flux], -1)
    return Candidates(xy_px=xy, peak_xy=np.stack([x, y], -1), peak_dn=image[y, x], flux_dn=flux, pixels=(lit > 0).sum(0),
                      elongation=np.ones(len(x)), blend=np.zeros(len(x), bool))
