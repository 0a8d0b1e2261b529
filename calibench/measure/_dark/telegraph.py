"""Random telegraph noise: pixels that jump between two levels, found in the time series of candidates only.

A jump leaves a surplus of temporal variance, so the stack's variance names the candidates; a second pass over the frames
fetches their values. The best split of the sorted values into two groups (least squares, Otsu 1979) is a telegraph pixel where
the groups lie further apart, in units of their own scatter, than any split of one noise distribution (2.65 for a Gaussian).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from ...records import Frame

LEAST_SURPLUS = 0.5  # of the typical variance; a step of 5 sigma on in 10 % of the frames makes 2.25
SURPLUS_BY_CHANCE = 1e-5  # the share of normal pixels that are candidates
MOST_VALUES = 10_000_000  # of all series together: 40 MB
FEWEST_FRAMES = 12
SPLIT_GAUSSIAN, SPLIT_PER_ROOT_FRAMES = 3.3, 6.0
LEAST_SHARE, LEAST_MINORITY, LEAST_SWITCHES = 0.04, 3, 2
CHUNK = 4096
FAILING_SHARE = 0.7  # a defect shows in more than this share of the repeats
NORMAL_AT_SHARE = -0.5244  # where 30 % of a normal distribution lie below


@dataclass(frozen=True, kw_only=True)
class TimeSeries:
    """Values of some pixels over the frames of one level: xy_px (P, 2), values_dn (N, P) float32, each frame's common level
    (mean of its image minus the mean of all) taken off."""

    xy_px: np.ndarray
    values_dn: np.ndarray


def candidates(variance_dn2: np.ndarray, freedom: int, typical_dn2: float, also: np.ndarray) -> np.ndarray:
    """(P, 2) x, y of the pixels whose temporal variance has a surplus; of too many for the memory the largest, those in `also`
    (H, W) bool first."""
    limit = max(1 + LEAST_SURPLUS, chdtri(freedom, SURPLUS_BY_CHANCE) / freedom)
    rows, columns = np.nonzero(variance_dn2 > limit * typical_dn2)
    order = np.lexsort((-variance_dn2[rows, columns], ~also[rows, columns]))[: MOST_VALUES // (freedom + 2)]
    return np.stack([columns[order], rows[order]], -1)


def fetch(frames: Iterable[Frame], level_of: Callable[[Frame], int | None], levels_dn: Sequence[np.ndarray],
          xy_px: Sequence[np.ndarray]) -> list[TimeSeries] | None:
    """Time series at several levels by one second pass; None where it does not give the same frames. level_of: number of the
    level that a frame is of (None: of no such level); levels_dn: for each level the (N,) means of its frames, in order."""
    values = [np.empty((len(means), len(xy)), np.float32) for means, xy in zip(levels_dn, xy_px, strict=True)]
    taken = [0] * len(values)
    for frame in frames:
        i = level_of(frame)
        if i is None:
            continue
        if taken[i] == len(values[i]):
            return None
        x, y = xy_px[i].T
        values[i][taken[i]] = frame.data[y, x]
        taken[i] += 1
    if taken != [len(v) for v in values]:
        return None
    for v, means in zip(values, levels_dn, strict=True):
        v -= (means[:, None] - means.mean()).astype(np.float32)
    return [TimeSeries(xy_px=xy, values_dn=v) for xy, v in zip(xy_px, values, strict=True)]


def two_levels(values_dn: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which of the series (N, P) are telegraph signals (P,) bool, their step in DN, and the share of frames in the upper."""
    frames, pixels = values_dn.shape
    found, step, duty = np.zeros(pixels, bool), np.zeros(pixels), np.zeros(pixels)
    if frames < FEWEST_FRAMES:
        return found, step, duty
    for first in range(0, pixels, CHUNK):
        part = np.s_[first:first + CHUNK]
        found[part], step[part], duty[part] = _split(values_dn[:, part].astype(float))
    return found, step, duty


def _split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    frames, pixels = values.shape
    least = max(LEAST_MINORITY, int(np.ceil(LEAST_SHARE * frames)))
    ordered = np.sort(values - values.mean(0), axis=0)
    low = np.arange(1, frames)[:, None]  # so many in the lower group
    below = np.cumsum(ordered, axis=0)[:-1] / low
    above = -below * low / (frames - low)  # the mean of all is 0
    between = low * below**2 + (frames - low) * above**2
    k = np.argmax(between[least - 1:frames - least], axis=0) + least - 1
    at = (k, np.arange(pixels))
    within = np.maximum((np.sum(ordered**2, axis=0) - between[at]) / (frames - 2), 1 / 12)  # at least quantisation
    step = above[at] - below[at]
    middle = (ordered[k, at[1]] + ordered[k + 1, at[1]]) / 2
    upper = values - values.mean(0) > middle
    switches = np.count_nonzero(np.diff(upper, axis=0), axis=0)
    apart = step / np.sqrt(within)
    limit = SPLIT_GAUSSIAN + SPLIT_PER_ROOT_FRAMES / np.sqrt(frames)
    return (apart > limit) & (switches >= LEAST_SWITCHES), step, upper.mean(0)


def confirmed(values_dn: np.ndarray, local_dn: np.ndarray, typical_dn2: float) -> np.ndarray:
    """(P,) bool: does each series (N, P) stand nearer to its mean than to the local level in more than FAILING_SHARE of the
    frames? A hit by a particle lifts the mean and fails here. The spread of normal noise is allowed for."""
    excess = values_dn.mean(0) - local_dn
    low = np.quantile(values_dn, 1 - FAILING_SHARE, axis=0) - NORMAL_AT_SHARE * np.sqrt(typical_dn2) - local_dn
    return low > excess / 2
