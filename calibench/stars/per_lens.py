"""What follows from a lens alone is computed once for a series of frames, not once a frame."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

import numpy as np

from ..geometry import projection
from ..records import Intrinsics

MOST_LENSES = 64
Result = TypeVar("Result")


def per_lens(function: Callable[[Intrinsics], Result]) -> Callable[[Intrinsics], Result]:
    """Decorator of a function of Intrinsics: its results for the last MOST_LENSES records are kept.

    Records are immutable, so the record itself, not its values, is the key; the weak reference tells it from a later one that
    came to lie at the same address.
    """
    kept: dict[int, tuple[weakref.ref, Result]] = {}

    @wraps(function)
    def once(lens: Intrinsics) -> Result:
        entry = kept.get(id(lens))
        if entry is None or entry[0]() is not lens:
            while len(kept) >= MOST_LENSES:
                kept.pop(next(iter(kept)))
            entry = kept[id(lens)] = weakref.ref(lens), function(lens)
        return entry[1]
    return once


@per_lens
def lens_terms(lens: Intrinsics) -> tuple[np.ndarray, np.ndarray, bool, float]:
    """A lens as compiled loops take it: camera (6,): fx, fy, cx, cy, -1 where mirrored else 1, skew; terms (12,) in OpenCV's
    order, zero where the model has none; whether it is a fisheye; radius (fisheye: angle) up to which it does not fold."""
    camera = np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px, -1.0 if lens.mirrored else 1.0, lens.skew_px or 0.0])
    terms = np.zeros(12)
    terms[:len(lens.distortion)] = lens.distortion
    return camera, terms, lens.is_fisheye, projection.fold_angle(lens) if lens.is_fisheye else projection.fold_radius(lens)
