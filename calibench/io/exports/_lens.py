"""What the exports of the lens share: intrinsics that a format can hold, and how their numbers and doubts are spelt."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import BadInput
from ...records import CalibrationMap, Intrinsics

CONVENTION = "pixel (0, 0) is the centre of the top-left pixel"


def measured_lens(calmap: CalibrationMap, path: Path | str) -> Intrinsics:
    """The map's intrinsics.

    Raises:
        BadInput: they were not measured, or are mirrored or skewed, which the formats of other programs cannot say.
    """
    if "intrinsics" not in calmap.measured:
        raise BadInput("the map has no intrinsics to export", file=path,
                       mend="add them: calibench intrinsics FRAMES --board 9x6 --square-mm 25 --map MAP --map-out MAP")
    if calmap.intrinsics.mirrored:
        raise BadInput("the map's intrinsics are mirrored, and this format has no word for it", file=path,
                       mend="flip the frames when they are read out, and measure the intrinsics on those")
    if calmap.intrinsics.skew_px is not None:
        raise BadInput(f"the map's intrinsics have a skew of {calmap.intrinsics.skew_px:.4g} px, and this format has no "
                       "word for it", file=path, mend="measure the intrinsics without --skew")
    return calmap.intrinsics


def named_model(lens: Intrinsics, names: Mapping[str, str], program: str, path: Path | str) -> str:
    """The program's name for the lens model, from its `names` by ours.

    Raises:
        BadInput: the program has no such model.
    """
    if lens.model not in names:
        raise BadInput(f"{program} cannot hold the intrinsics' lens model {lens.model}", file=path,
                       mend=f"measure with one of its models ({', '.join(names)}: --model), or export to another format")
    return names[lens.model]


def number_text(value: float) -> str:
    """The shortest text that reads back as the same double, also as YAML: there 3e-07 without a point is no number."""
    if np.isinf(value):
        return ".Inf" if value > 0 else "-.Inf"
    mantissa, e, exponent = repr(float(value)).partition("e")
    return f"{mantissa}.0e{exponent}" if e and "." not in mantissa else mantissa + e + exponent


def number_list(values: np.ndarray) -> str:
    """Values in one line: 1.0, 0.5, 3.0e-07."""
    return ", ".join(number_text(value) for value in np.ravel(values))


def remarks(lens: Intrinsics) -> tuple[str, str]:
    """Comment lines for what most formats have no field for: pixel convention, uncertainty of the parameters."""
    sd = np.sqrt(np.diag(lens.covariance))
    stated = ", ".join(f"{name} {value:.3g}" if np.isfinite(value) else f"{name} unknown"
                       for name, value in zip(lens.parameter_names, sd, strict=True))
    return f"# {CONVENTION}", f"# uncertainty (1 sigma): {stated}"
