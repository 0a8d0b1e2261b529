"""Trials over conditions of simulated spots: one panel for each thing that is varied, everything else as it usually is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from ...validate.case import Trial
from ...validate.simulated_spots import CONDITIONS, Condition
from ..draw import FAINT

LABELS = {"noise_px": "centroid noise (px)", "false": "false spots", "missing": "part of the stars missing (%)",
          "most": "stars (the brightest)"}


class Varied(NamedTuple):
    """What one panel varies: its label, the conditions' names in order, and the values on the panel's axis."""

    label: str
    names: tuple[str, ...]
    values: tuple[float, ...]


def varied(trial: Trial) -> list[Varied]:
    """The panels of a trial: the conditions among its rows that differ from the usual one in one thing only."""
    asked, usual, panels = {row[0] for row in trial.rows}, Condition(), []
    for name, label in LABELS.items():
        alone = {condition: values._asdict()[name] for condition, values in CONDITIONS.items()
                 if condition in asked and values._replace(**{name: getattr(usual, name)}) == usual}
        order = tuple(sorted(alone, key=alone.__getitem__))
        if len(order) > 1:
            scale = 100 if name == "missing" else 1
            panels.append(Varied(label, order, tuple(scale * float(alone[condition]) for condition in order)))
    return panels


def figures(trial: Trial, column: str) -> dict[tuple[str, str], float]:
    """(condition, whose) -> figure of that column; the first two columns name them."""
    at = trial.columns.index(column)
    return {(row[0], row[1]): float(row[at]) for row in trial.rows}


def draw(axes: Axes, panel: Varied, values: dict[tuple[str, str], float], whose: str, **line: object) -> None:
    """One line of a panel, at evenly spaced values."""
    axes.plot(range(len(panel.names)), [values.get((name, whose), np.nan) for name in panel.names], **line)


def frame(axes: Axes, panel: Varied) -> None:
    """Labels of a panel's axis."""
    axes.set_xticks(range(len(panel.values)), [f"{value:g}" for value in panel.values])
    axes.set_xlabel(panel.label)
    axes.grid(axis="y", color=FAINT)
