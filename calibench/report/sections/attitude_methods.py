"""Attitude methods: errors, error bars and time of every one on the same identified frames."""

from __future__ import annotations

import numpy as np

from ...validate.case import Trial
from ..draw import BLUE, FAINT, GREY, ORANGE, WIDE, png, sheet
from ..numbers import number, sentence
from ..section import Figure, Section
from ..story import Story
from . import _conditions

ORDER = 73
TITLE = "Attitude methods compared"
TWO_STARS = "triad"


def render(story: Story) -> Section | None:
    trial = story.trials.get("attitude_methods")
    if trial is None:
        return None
    return Section(paragraphs=(f"{trial.reading[:1].upper()}{trial.reading[1:]}.",), figures=(_errors(trial), _bars(trial)))


def _methods(trial: Trial) -> list[str]:
    return list(dict.fromkeys(row[1] for row in trial.rows))


def _errors(trial: Trial) -> Figure:
    """Error across and about the boresight; one panel for each thing that is varied."""
    panels, methods = _conditions.varied(trial), _methods(trial)
    made, axes = sheet((WIDE[0], 5.4), len(panels), 2, sharey="row")
    for row, (column, label) in enumerate((("cross_arcsec", "across the boresight (arcsec)"),
                                           ("roll_arcsec", "about the boresight (arcsec)"))):
        values = _conditions.figures(trial, column)
        for panel, at in zip(panels, axes[row * len(panels):], strict=False):
            for method in methods:
                of_two = method == TWO_STARS
                _conditions.draw(at, panel, values, method, color=ORANGE if of_two else BLUE, marker="^" if of_two else "o",
                                 markersize=3.5, linewidth=1.2, label=method if of_two else None)
            at.set_yscale("log")
            _conditions.frame(at, panel)
        axes[row * len(panels)].set_ylabel(label)
    made.legend([axes[0].lines[methods.index(m)] for m in (methods[0], TWO_STARS) if m in methods],
                ["all that weigh every star", f"{TWO_STARS}, two stars"], loc="outside upper center", ncols=2)
    cross = _conditions.figures(trial, "cross_arcsec")
    first = trial.rows[0][0]
    rest = [cross[first, method] for method in methods if method != TWO_STARS]
    return Figure(title="Error over noise, false spots, missing stars and number of stars", png=png(made), wide=True,
                  reading=sentence(f"{first}: {number(min(rest), 3)} to {number(max(rest), 3)} arcsec across the boresight for "
                                   f"{len(rest)} methods, {number(cross.get((first, TWO_STARS)), 3)} for {TWO_STARS}"))


def _bars(trial: Trial) -> Figure:
    """NEES of every condition, and CPU time, by method."""
    methods, nees, ms = _methods(trial), _conditions.figures(trial, "nees"), _conditions.figures(trial, "cpu_ms")
    made, (left, right) = sheet(WIDE, 2)
    for at, method in enumerate(methods):
        values = [v for (_, whose), v in nees.items() if whose == method and np.isfinite(v)]
        left.plot([at] * len(values), values, linestyle="", marker="o", markersize=4, color=BLUE, alpha=0.6)
    left.axhline(1, color=GREY, linewidth=0.8)
    every = [v for v in nees.values() if np.isfinite(v)]
    left.set(ylabel="normalised error squared (1: right)", ylim=(0, 1.1 * max(*every, 1)))
    right.bar(range(len(methods)), [np.median([v for (_, whose), v in ms.items() if whose == m]) for m in methods], color=BLUE,
              width=0.6)
    right.set_ylabel("CPU time (ms a frame)")
    for axes in (left, right):
        axes.set_xticks(range(len(methods)), methods)
        axes.grid(axis="y", color=FAINT)
    return Figure(title="Error bars (a point for each condition) and time", png=png(made), wide=True,
                  reading=sentence(f"normalised errors squared of {number(min(every), 3)} to {number(max(every), 3)}, "
                                   f"on average {number(float(np.mean(every)), 3)}"))
