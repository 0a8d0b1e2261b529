"""Story: everything a report tells, gathered by the session; sections only read it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..records import CalibrationMap, Measurement, Verdict
from ..stars.sky_catalogue import SkyCatalogue
from ..stars.solve import Solution
from ..validate.case import SkyTruth, Trial


@dataclass(frozen=True, kw_only=True)
class ShotStory:
    """One kind of shot of the protocol: what was asked, what was found. status: pass, fail or skipped."""

    name: str
    folder: str
    what: str
    why: str
    wanted: int
    found: int
    status: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SkyStory:
    """One sky frame: signal (H, W) DN above dark for the overlay, the solution without and with the map, truth or None.

    catalogue: the sky in which both were identified; without it the overlay marks stars and cannot name them.
    """

    name: str
    signal_dn: np.ndarray
    raw: Solution
    calibrated: Solution
    truth: SkyTruth | None = None
    catalogue: SkyCatalogue | None = None


@dataclass(frozen=True, kw_only=True)
class Story:
    """shots in the protocol's order; measurements and trials by name; star_names: HIP -> text to print beside a star.
    series: the solutions of a series of sky frames in their order, where their images are not kept (else those of `sky`)."""

    title: str
    why: str
    created: str
    software: str
    calmap: CalibrationMap
    shots: tuple[ShotStory, ...] = ()
    measurements: Mapping[str, Measurement] = field(default_factory=dict)
    verdicts: tuple[Verdict, ...] = ()
    sky: tuple[SkyStory, ...] = ()
    series: tuple[Solution, ...] = ()
    trials: Mapping[str, Trial] = field(default_factory=dict)
    star_names: Mapping[int, str] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
