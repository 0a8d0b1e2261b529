"""find_stars: from a raw frame and a map to spots, fast: only what is needed is corrected.

1. Detection on raw DN against a threshold for each pixel, made once for a series (stars/sky_level.py).
2. The windows around the candidates are corrected, equal to the corrected full frame.
3. Centroids with covariance by the named centroider; flags.

The sky's level is carried from frame to frame. It holds while map, exposure, gain setting, white level, size and type are the
same, the temperature within SAME_TEMPERATURE_C, and the sky is: each frame is sampled (every DRIFT_ROWS-th row) and compared
with it, in cells. While no cell has moved by more than MOST_DRIFT_SIGMA and the noise by no more than MOST_NOISE_CHANGE, the
drift is taken into account; beyond that the level is made anew from the frame at hand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..calmap.windows import SeriesLayers
from ..records import CalibrationMap, Frame, Spots
from ..spots.false_alarms import FALSE_ALARMS
from ..spots.measured import brightest, measured
from .sky_level import RawScene, SkyLevel

MOST_DRIFT_SIGMA, MOST_NOISE_CHANGE = 0.25, 0.05


@dataclass
class FindState:
    """What is computed once for a series of frames of one camera. false_alarms: spots a frame that noise may give; k_sigma: the
    threshold of detection in its place.

    made: how often the sky's level was made. `layers` and `level` are None before the first frame."""

    false_alarms: float = FALSE_ALARMS
    k_sigma: float | None = None
    centroider: str = "psf_map"
    made: int = 0
    layers: SeriesLayers | None = None
    level: SkyLevel | None = None


def find_stars(frame: Frame, calmap: CalibrationMap, state: FindState) -> Spots:
    """Spots of a raw frame, brightest first; `state` carries what frames of a series share.

    Raises:
        BadInput: the frame has another size than the map. UsageError: unknown centroider.
    """
    scene = _scene(frame, calmap, state)
    candidates, restless = brightest(scene.candidates(), scene.level.busy)
    return measured(scene, candidates, restless, scene.near(candidates.peak_xy), centroider=state.centroider,
                    image_size_px=frame.image_size_px)


def _scene(frame: Frame, calmap: CalibrationMap, state: FindState) -> RawScene:
    """The frame on the carried level, or on a new one where the frame asks for it."""
    if state.layers is None or state.layers.calmap is not calmap:
        state.layers, state.level = SeriesLayers(calmap), None
    data, layers, level = _scanned(frame.data), state.layers.of(frame), state.level
    if level is not None and level.serves(frame):
        drifted, louder = level.sampled(data)
        if max(drifted.max(), -drifted.min()) <= MOST_DRIFT_SIGMA and abs(louder - 1) <= MOST_NOISE_CHANGE:
            return RawScene(data=data, layers=layers, level=level, drifted=drifted, louder=louder)
    level = state.level = SkyLevel.of(frame, data, layers, calmap, state.k_sigma, state.false_alarms)
    state.made += 1
    return level.scene(data, layers)


def _scanned(data: np.ndarray) -> np.ndarray:
    """The data in a type that the scan is compiled for."""
    if data.dtype in (np.uint16, np.float32):
        return data
    return data.astype(np.uint16 if data.dtype.kind == "u" and data.dtype.itemsize < 2 else np.float32)
