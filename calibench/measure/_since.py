"""Which defects a measurement confirms of the session before, whose map was handed in, which are new and which are gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..calmap.compare import LAYER_OF_CLASS, DefectChange, defect_changes
from ..records import CalibrationMap, Measurement, Quantity

COUNTS = {"confirmed": "in the map given and now", "new": "now and not in the map given",
          "gone": "in the map given and not now"}
CERTAIN = {f"{count}_certain": f"{count}, and changed by 5 sigma once both sessions are brought to one temperature"
           for count in ("new", "gone")}


def with_changes(measurement: Measurement, before: CalibrationMap | None, classes: tuple[str, ...], layer: str) -> Measurement:
    """The measurement with the counts of each class against the map of another session.

    Args:
        before: the map handed in; nothing is said where it is None or does not hold `layer`, by which it would know of them.
        classes: flags that this measurement finds.
    """
    if before is None or not {layer, "defects"} <= before.measured or before.image_size_px != measurement.image_size_px:
        return measurement
    then = {sha256 for key, sha256 in before.inputs.items() if key.startswith(f"{measurement.name}/")}
    same = bool(then & set(measurement.provenance.inputs.values()))
    layers = {name: value for name, value in (*measurement.maps.items(), *measurement.layers.items())
              if np.isfinite(value).all()}
    now = CalibrationMap(image_size_px=before.image_size_px, measured=frozenset(layers), **layers)
    changes = {} if same else {change.name: change for change in defect_changes(before, now)}
    rows = [_row(name, count, said, changes.get(name), same) for name in classes
            for count, said in (COUNTS | (CERTAIN if name in LAYER_OF_CLASS else {})).items()]
    return replace(measurement, quantities=(*measurement.quantities, *rows))


def _row(name: str, count: str, said: str, change: DefectChange | None, same: bool) -> Quantity:
    value = None if same else 0 if change is None else getattr(change, count)
    reason = ("the map given is of the same frames, which confirm nothing" if same else
              "a count" if value is not None else "the sessions cannot be brought to one temperature")
    return Quantity(name=f"{name}_{count}", value=value, unit="1", source=f"{name} pixels {said}", reason=reason)
