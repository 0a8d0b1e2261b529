"""Identifiers: every one on the same simulated spots, over noise, false, missing and few stars."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import FixedLocator

from ...validate.case import Trial
from ..draw import BLUE, GREEN, INK, ORANGE, RED, SEQUENTIAL, WIDE, png, sheet
from ..numbers import number, plural, sentence
from ..section import Figure, Section, Table
from ..story import Story
from . import _conditions

ORDER = 72
TITLE = "Identifiers compared"
FAMILIES = {
    "the default": (BLUE, "o", ("pattern",)),
    "triangles": (GREEN, "s", ("area_polar_moment", "oriented_triangles", "planar_triangle", "spherical_triangle")),
    "pairs of stars": (ORANGE, "^", ("angle", "geometric_voting", "pyramid", "pyramid_k_vector", "pyramid_linear",
                                     "pyramid_quadratic")),
    "neighbours of a star": (RED, "v", ("grid", "liebe", "polestar", "zhang")),
}
LEGIBLE = 0.55  # of full colour, from which letters over it are dark


def render(story: Story) -> Section | None:
    trial = story.trials.get("identifiers")
    if trial is None:
        return None
    return Section(paragraphs=(f"{trial.reading[:1].upper()}{trial.reading[1:]}.",), figures=(_lines(trial), _cells(trial)),
                   tables=(_sizes(trial),))


def _names(trial: Trial) -> list[str]:
    return list(dict.fromkeys(row[1] for row in trial.rows))


def _lines(trial: Trial) -> Figure:
    """Success above, CPU time below; one panel for each thing that is varied."""
    panels, names = _conditions.varied(trial), _names(trial)
    made, axes = sheet((WIDE[0], 5.6), len(panels), 2, sharey="row")
    for row, column in enumerate(("solved_percent", "cpu_ms")):
        values = _conditions.figures(trial, column)
        for panel, at in zip(panels, axes[row * len(panels):], strict=False):
            for family, (colour, marker, members) in reversed(FAMILIES.items()):
                for i, name in enumerate(m for m in members if m in names):
                    _conditions.draw(at, panel, values, name, color=colour, marker=marker, markersize=3.5,
                                     linewidth=2.2 if family == "the default" else 0.9, label=family if i == 0 else None)
            _conditions.frame(at, panel)
        axes[row * len(panels)].set_ylabel("solved (%)" if column == "solved_percent" else "CPU time (ms a frame)")
    axes[-1].set_yscale("log")
    handles, labels = axes[-1].get_legend_handles_labels()
    made.legend(handles[::-1], labels[::-1], loc="outside upper center", ncols=len(labels))
    wrong, frames = sum(_conditions.figures(trial, "wrong").values()), sum(_conditions.figures(trial, "frames").values())
    solved = _means(trial, "solved_percent")
    best = max(solved.values())
    always = [name for name in names if solved[name] > best - 0.05]
    return Figure(title="Success and time over noise, false spots, missing stars and number of stars", png=png(made), wide=True,
                  reading=sentence(f"{number(wrong)} wrong of {plural(int(frames), 'answer')}",
                                   f"over all conditions {', '.join(always)} solved most, {number(best, 3)} %",
                                   "the fastest was " + min(names, key=_means(trial, "cpu_ms").__getitem__)))


def _means(trial: Trial, column: str) -> dict[str, float]:
    values = _conditions.figures(trial, column)
    return {name: float(np.mean([v for (_, whose), v in values.items() if whose == name])) for name in _names(trial)}


def _cells(trial: Trial) -> Figure:
    """Every identifier in every condition: colour is success, the number is CPU time."""
    solved, ms, means = _conditions.figures(trial, "solved_percent"), _conditions.figures(trial, "cpu_ms"), _means(
        trial, "solved_percent")
    conditions = list(dict.fromkeys(row[0] for row in trial.rows))
    names = sorted(_names(trial), key=lambda name: (-round(means[name], 1), _means(trial, "cpu_ms")[name]))
    made, (axes,) = sheet((WIDE[0], 1.6 + 0.26 * len(names)))
    grid = np.array([[solved[condition, name] for condition in conditions] for name in names])
    drawn = axes.imshow(grid, cmap=SEQUENTIAL, vmin=0, vmax=100, aspect="auto")
    for i, name in enumerate(names):
        for j, condition in enumerate(conditions):
            axes.text(j, i, number(ms[condition, name], 2), ha="center", va="center", fontsize=7.5,
                      color=INK if grid[i, j] > 100 * LEGIBLE else "white")
    axes.set_yticks(range(len(names)), names)
    axes.set_xticks(range(len(conditions)), [_broken(c) for c in conditions])
    axes.xaxis.set_minor_locator(FixedLocator([]))
    axes.tick_params(length=0)
    made.colorbar(drawn, ax=axes, pad=0.01, aspect=28).set_label("solved (%)")
    return Figure(title="Every identifier in every condition (numbers: CPU time, ms a frame)", png=png(made), wide=True,
                  reading=sentence(f"from top to bottom by success over all conditions: {names[0]} "
                                   f"{number(means[names[0]], 3)} %, {names[-1]} {number(means[names[-1]], 3)} %"))


def _broken(condition: str) -> str:
    """A condition's name in two lines."""
    return condition.replace(", ", ",\n").replace("noise ", "noise\n") if "noise" in condition or "," in condition else (
        condition.replace(" missing", "\nmissing"))


def _sizes(trial: Trial) -> Table:
    megabytes, seconds, solved, wrong = (_conditions.figures(trial, column)
                                         for column in ("table_mb", "table_s", "solved_percent", "wrong"))
    first, means = trial.rows[0][0], _means(trial, "solved_percent")
    columns = ("Identifier", "Solved, all conditions (%)", "Wrong", "CPU time, usual (ms)", "Table (MB)", "Built in (CPU s)")
    ms = _conditions.figures(trial, "cpu_ms")
    rows = tuple((name, number(means[name], 3), number(sum(v for (_, whose), v in wrong.items() if whose == name)),
                  number(ms[first, name], 3), number(megabytes[first, name], 2), number(seconds[first, name], 2))
                 for name in _names(trial))
    return Table(title="What each needs", columns=columns, rows=rows, numbers=frozenset(columns[1:]))
