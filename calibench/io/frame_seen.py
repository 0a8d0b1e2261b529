"""What is kept of a frame once its pixels are gone: all that the checks on a series ask."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..records import Frame
from .alignment import WORD_BITS, empty_low_bits

SAMPLE_PX = 5_000  # enough for a robust scatter to 2 %


@dataclass(frozen=True, kw_only=True)
class FrameSeen:
    """Fields as in `Frame`. level_dn: mean, largest_dn: maximum; noise_dn: robust scatter (1.4826 MAD) of a dark's pixels.

    left_bits: low bits that no pixel of a 16-bit frame uses (16 where it is black); 0 where its depth is settled.
    shift_bits: what was found since: its pixels are to be shifted right by so many bits.
    """

    name: str
    kind: str
    image_size_px: tuple[int, int]
    dtype: str
    bit_depth: int
    white_level_dn: float
    exposure_s: float | None
    temperature_c: float | None
    gain_setting: float | None
    bayer_pattern: str | None
    camera: str | None
    range_assumed: bool
    sha256: str
    notes: tuple[str, ...]
    level_dn: float
    largest_dn: float
    noise_dn: float
    left_bits: int
    shift_bits: int = 0

    def shifted(self, bits: int, note: str) -> FrameSeen:
        """The same frame with its pixels shifted right."""
        depth = WORD_BITS - bits
        return dataclasses.replace(self, bit_depth=depth, white_level_dn=float(2**depth - 1), level_dn=self.level_dn / 2**bits,
                                   largest_dn=int(self.largest_dn) >> bits, noise_dn=self.noise_dn / 2**bits, left_bits=0,
                                   shift_bits=bits, notes=(note,))

    def settle(self, frame: Frame) -> Frame:
        """The frame, read anew, as the series' checks settled it; the same object where they left it as it was."""
        settled = self.bit_depth, self.white_level_dn, self.notes
        if settled == (frame.bit_depth, frame.white_level_dn, frame.notes):
            return frame
        data = frame.data >> self.shift_bits if self.shift_bits else frame.data
        return dataclasses.replace(frame, data=data, bit_depth=self.bit_depth, white_level_dn=self.white_level_dn,
                                   notes=self.notes)


def seen(frame: Frame) -> FrameSeen:
    """What a series' checks ask of this frame."""
    figures = {"level_dn": float("nan"), "noise_dn": float("nan")}
    if frame.kind in ("dark", "flat"):  # what claims nothing of its light is not asked for its level
        from ..measure._frames.glance import glance  # loads compiled code, which other frames do not need

        figures |= {"level_dn": glance(frame).level_dn, "largest_dn": glance(frame).largest}
    else:
        figures["largest_dn"] = frame.data.max().item()
    if frame.kind == "dark":
        figures["noise_dn"] = _noise_dn(frame.data)
    said = {name: getattr(frame, name) for name in (
        "name", "kind", "image_size_px", "bit_depth", "white_level_dn", "exposure_s", "temperature_c", "gain_setting",
        "bayer_pattern", "camera", "range_assumed", "sha256", "notes")}
    return FrameSeen(**said, **figures, dtype=str(frame.data.dtype), left_bits=_left_bits(frame))


def _left_bits(frame: Frame) -> int:
    if frame.bit_depth != WORD_BITS or frame.data.dtype != np.uint16:
        return 0
    return empty_low_bits(frame.data) if frame.data.any() else WORD_BITS


def _noise_dn(data: np.ndarray) -> float:
    step = max(1, int(np.sqrt(data.size / SAMPLE_PX)))
    sample = data[::step, ::step].astype(np.float32)
    return 1.4826 * float(np.median(np.abs(sample - np.median(sample))))
