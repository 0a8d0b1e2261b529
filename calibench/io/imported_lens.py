"""A lens that another program calibrated, as a measurement for the map: it says where it came from and what is unknown."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from .. import registry
from ..records import Measurement, Provenance

FOLDER = "calibench.io.imports"


def imported_lens(path: Path | str, format_: str) -> Measurement:
    """The measurement `intrinsics` of a lens file in a format of the open folder `imports`.

    It takes the name of our own measurement, so that in a map either replaces the other.

    Raises:
        UsageError: no such format. BadInput: what the format's reader says of the file.
    """
    path = Path(path)
    lens = registry.load(FOLDER, format_).read(path)
    warnings = [f"the lens was imported from {path.name} ({format_}); its frames are not known to this map"]
    if not np.all(np.isfinite(np.diag(lens.covariance))):
        warnings.append("the imported lens has parameters of unknown uncertainty: what depends on it cannot be stated")
    return Measurement(
        name="intrinsics", image_size_px=lens.image_size_px, intrinsics=lens, warnings=tuple(warnings),
        provenance=Provenance(inputs={path.name: hashlib.sha256(path.read_bytes()).hexdigest()},
                              settings={"imported_from": path.name, "format": format_}))
