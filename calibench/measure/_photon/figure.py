"""A figure of photon transfer with its 1-sigma error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Figure(NamedTuple):
    """value None: not available, `reason` says why. A reason beside a value is a remark."""

    value: float | None
    error: float | None = None
    reason: str = ""

    def times(self, factor: float) -> Figure:
        return self if self.value is None else Figure(self.value * factor, abs(self.error * factor), self.reason)

    def over(self, other: Figure) -> Figure:
        """The quotient of two figures whose errors are independent; what is missing in either is missing."""
        if self.value is None or other.value is None:
            return Figure(None, None, self.reason if self.value is None else other.reason)
        value = self.value / other.value
        return Figure(value, float(np.hypot(self.error, value * other.error) / abs(other.value)), self.reason or other.reason)

    def power(self, exponent: float) -> Figure:
        if self.value is None:
            return self
        value = self.value**exponent
        return Figure(value, abs(exponent) * value * self.error / self.value, self.reason)

    def decibel(self) -> Figure:
        """20 log10."""
        if self.value is None:
            return self
        unit = 20 / float(np.log(10))
        return Figure(unit * float(np.log(self.value)), unit * self.error / self.value, self.reason)

    def widened(self, error: float) -> Figure:
        """With an independent error more."""
        return self if self.value is None else self._replace(error=float(np.hypot(self.error, error)))
