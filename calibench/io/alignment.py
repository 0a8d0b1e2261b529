"""Alignment: where the converter's bits sit in a 16-bit word.

Cameras of 10 to 14 bits often write their value shifted to the top of the word: all values are multiples of 2^k. Taken as
they stand, such data are 2^k times too large, and gain, noise and saturation come out wrong without a sign.
"""

from __future__ import annotations

import numpy as np

from ..errors import BadInput

WORD_BITS = 16
FULL_WORD = 2**WORD_BITS - 1
# A frame must give this many bits of evidence (empty low bits times distinct values) before it is shifted: by chance,
# values of a right-aligned camera pass with a probability of 2^-20.
MIN_EVIDENCE_BITS = 20


def empty_low_bits(data: np.ndarray) -> int:
    """Number k of low bits that no pixel uses, 0 <= k < 16. data: (H, W) uint16.

    The full word 65535 is left out: some cameras clip to it although their data are left-aligned.
    """
    used = 0
    for part in (data[:1], data):  # the first row settles it for nearly every right-aligned frame
        used = int(np.bitwise_or.reduce(np.where(part == FULL_WORD, 0, part), axis=None))
        if used & 1:
            return 0
    return (used & -used).bit_length() - 1 if used else 0


def left_shift_of(data: np.ndarray) -> int:
    """By how many bits the data are left-aligned, judged by their values: 0 where the evidence is too weak.

    A frame of few distinct values (black, clipped, constant) may be a multiple of 2^k by chance; it is left as it is.
    """
    bits = empty_low_bits(data)
    if bits == 0:
        return 0
    distinct = np.count_nonzero(np.bincount(data.ravel(), minlength=1))
    return bits if bits * distinct >= MIN_EVIDENCE_BITS else 0


def right_aligned(data: np.ndarray, *, bit_depth: int | None, alignment: str | None, file: object = None
                  ) -> tuple[np.ndarray, int, str | None]:
    """The data right-aligned, their bit depth and what was done (None: nothing to say). data: (H, W) uint16.

    bit_depth and alignment ("left", "right") are what header or sidecar state; alignment None: judged by the values.

    Raises:
        BadInput: the values do not fit the stated bit depth in the stated (or any) alignment.
    """
    largest = int(data.max())
    if alignment == "left":
        if bit_depth is None:
            raise BadInput("alignment is stated as left, but no bit depth", file=file, mend="state bit_depth in the sidecar")
        shift = WORD_BITS - bit_depth
        if empty_low_bits(data) < shift and largest > 0:
            raise BadInput(f"stated as {bit_depth} bits left-aligned, but the low {shift} bits are in use", file=file,
                           mend="correct bit_depth or alignment in the sidecar")
    elif alignment == "right" or (bit_depth is not None and bit_depth < WORD_BITS and largest < 2**bit_depth):
        shift = 0
    else:
        shift = left_shift_of(data)
        if shift and bit_depth is not None and bit_depth < WORD_BITS:
            shift = WORD_BITS - bit_depth if shift >= WORD_BITS - bit_depth else 0
    if shift:
        depth = WORD_BITS - shift
        how = "stated" if alignment == "left" else f"all values are multiples of {2**shift}"
        return data >> shift, depth, f"left-aligned {depth}-bit data in 16 bits ({how}); shifted right by {shift} bits"
    depth = bit_depth or WORD_BITS
    if largest >= 2**depth:
        raise BadInput(f"values up to {largest} do not fit the stated {depth} bits", file=file,
                       mend="correct bit_depth (the bits of the converter, right-aligned in the file)")
    if bit_depth is None:
        return data, depth, (f"16 bits assumed, largest value {largest}: "
                             "where the converter has fewer bits, state bit_depth in a sidecar")
    return data, depth, None
