"""The book kept while frames stream by: which file, which conditions, whether the frames belong together, which are odd."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np

from ...errors import BadInput
from ...records import Frame, Provenance
from .clock import check_clock
from .glance import glance
from .watch import Watch

TEMPERATURE_DRIFT_C = 1.0


class Ledger:
    """Takes frames one after the other; refuses another size, gain or depth, and tells duplicates.

    Args:
        settings: the measurement's settings (a dataclass), kept in the provenance.
        what: what the frames are, for messages ("dark frames").
    """

    def __init__(self, settings: object, what: str):
        self._settings, self._what = settings, what
        self._first: Frame | None = None
        self._seen: dict[str | int, str] = {}
        self._watch = Watch()
        self._said: dict[str, set] = {name: set() for name in ("exposure_s", "temperature_c", "date_obs", "camera")}
        self._taken: list[tuple[str, float]] = []  # start and exposure of darks and flats that state both
        self.inputs: dict[str, str] = {}
        self.rejected: list[tuple[str, str]] = []
        self.lossy = False

    def take(self, frame: Frame) -> bool:
        """Book a frame. False: it is a duplicate and was put on the rejected list.

        Raises:
            BadInput: image size, converter depth or gain setting differ from the first frame's.
        """
        if self._first is None:
            nothing = np.broadcast_to(frame.data.dtype.type(0), frame.data.shape)  # of no size: the pixels need not stay
            self._first = dataclasses.replace(frame, data=nothing)
        first = self._first
        for name, unit in (("image_size_px", " px"), ("bit_depth", " bit"), ("gain_setting", "")):
            mine, theirs = getattr(frame, name), getattr(first, name)
            if mine != theirs:
                raise BadInput(f"{name} is {mine}{unit}, but {theirs}{unit} in {first.name}: these are not one session",
                               file=frame.file or None, mend=f"give {self._what} of one camera setting at a time")
        digest = frame.sha256 or hashlib.sha256(np.ascontiguousarray(frame.data)).hexdigest()
        if digest in self._seen:
            self.reject(frame, f"the same data as {self._seen[digest]}")
            return False
        if frame.kind in ("dark", "flat"):
            seen = glance(frame)
            if seen.digest in self._seen and seen.noisy:
                self.reject(frame, f"the same pixels as {self._seen[seen.digest]}, to the last bit of their noise")
                return False
            self._seen[seen.digest] = frame.name
            self._watch.take(frame, seen)
            if frame.date_obs is not None and frame.exposure_s is not None:
                self._taken.append((frame.date_obs, frame.exposure_s))
        self._seen[digest] = frame.name
        self.inputs[frame.label or f"frame {len(self.inputs) + 1}"] = digest
        self.lossy |= frame.lossy
        for name, values in self._said.items():
            if getattr(frame, name) is not None:
                values.add(getattr(frame, name))
        return True

    def reject(self, frame: Frame, reason: str) -> None:
        """Put a frame on the rejected list."""
        self.rejected.append((frame.file or frame.name, reason))

    @property
    def first(self) -> Frame:
        """The first frame, which speaks for all in size, depth and gain, without its pixels (zeros).

        Raises:
            BadInput: there was none.
        """
        if self._first is None:
            raise BadInput(f"no {self._what} were given", mend="name files or a folder that holds them")
        return self._first

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know about these frames as a whole. Raises BadInput where `check_clock` does."""
        out = list(check_clock(self._taken))
        if self.lossy:
            out.append(f"{self._what}: 8-bit or lossy files")
        celsius = self._said["temperature_c"]
        if celsius and max(celsius) - min(celsius) > TEMPERATURE_DRIFT_C:
            out.append(f"temperature drifted from {min(celsius):.1f} to {max(celsius):.1f} C")
        return (*out, *self._watch.warnings)

    def provenance(self) -> Provenance:
        """Inputs with their hashes, settings, and the conditions under the names of `records.Conditions`."""
        def span(name: str) -> tuple | None:
            return (min(self._said[name]), max(self._said[name])) if self._said[name] else None
        cameras = self._said["camera"]
        conditions = {name: span(name) for name in ("exposure_s", "temperature_c", "date_obs")}
        depth = None if self.first.range_assumed else self.first.bit_depth
        conditions |= {"gain_setting": self.first.gain_setting, "bit_depth": depth,
                       "camera": ", ".join(sorted(cameras)) or None}
        return Provenance(inputs=self.inputs, settings=dataclasses.asdict(self._settings), conditions=conditions)
