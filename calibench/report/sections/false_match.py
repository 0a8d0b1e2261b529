"""False matches: the limit that is set for the odds against the rate of wrong answers."""

from __future__ import annotations

import numpy as np

from ...validate.case import Trial
from ..draw import BLUE, FAINT, GREEN, GREY, ORANGE, png, sheet
from ..numbers import number, plural, sentence
from ..section import Figure, Section
from ..story import Story

ORDER = 74
TITLE = "False matches"
NONE_SEEN = 3.0  # what may be expected, to 95 %, where none was seen
COLOURS = ((ORANGE, "o"), (BLUE, "s"))


def render(story: Story) -> Section | None:
    trial = story.trials.get("false_match")
    if trial is None:
        return None
    return Section(paragraphs=(f"{trial.reading[:1].upper()}{trial.reading[1:]}.",), figures=(_rates(trial), _solved(trial)))


def _by_kind(trial: Trial) -> dict[str, np.ndarray]:
    """Kind of spots -> (limits, 4): limit, sets, solved, wrong."""
    kinds = dict.fromkeys(row[0] for row in trial.rows)
    return {kind: np.array([row[1:5] for row in trial.rows if row[0] == kind], float) for kind in kinds}


def _rates(trial: Trial) -> Figure:
    """Observed rate of wrong answers; where there was none, the rate that three expected ones would be (95 %)."""
    made, (axes,) = sheet((5.6, 4.4))
    every, told = np.array([row[1] for row in trial.rows], float), []
    axes.plot([every.min(), every.max()], [every.min(), every.max()], color=GREY, linewidth=1, label="as stated")
    for (colour, marker), (kind, (limit, sets, _, wrong)) in zip(COLOURS, ((k, v.T) for k, v in _by_kind(trial).items()),
                                                                   strict=False):
        seen = wrong > 0
        rate = wrong / sets
        if seen.any():
            axes.errorbar(limit[seen], rate[seen], 0.9 * rate[seen] / np.sqrt(wrong[seen]), color=colour, marker=marker,
                          linestyle="", capsize=2, label=f"{kind}: observed")
        if not seen.all():
            axes.plot(limit[~seen], NONE_SEEN / sets[~seen], color=colour, marker="v", linestyle="", fillstyle="none",
                      label=f"{kind}: none, at most (95 %)")
        told.append(f"{kind}: {number(wrong[0])} wrong of {plural(int(sets[0]), 'set')} at the limit "
                    f"{number(limit[0], 1)}")
    axes.set(xscale="log", yscale="log", xlabel="limit of the false-match probability", ylabel="rate of wrong answers")
    axes.grid(color=FAINT)
    axes.legend(loc="lower right")
    return Figure(title="Stated against observed", png=png(made), reading=sentence(*told))


def _solved(trial: Trial) -> Figure:
    """What a stricter limit costs: sets with part of the truth that are still answered."""
    made, (axes,) = sheet((5.6, 4.4))
    told = []
    for kind, values in _by_kind(trial).items():
        limit, sets, solved, wrong = values.T
        if (solved > wrong).any():
            right = 100 * (solved - wrong) / sets
            axes.semilogx(limit, right, color=GREEN, marker="s", markersize=4, label=f"{kind}, rightly")
            told.append(f"{kind}: {number(float(right[0]), 3)} % rightly answered at {number(limit[0], 1)}, "
                        f"{number(float(right[-1]), 3)} % at {number(limit[-1], 1)}")
    axes.set(xlabel="limit of the false-match probability", ylabel="answered (% of the sets)", ylim=(0, None))
    axes.grid(color=FAINT)
    axes.legend(loc="upper left")
    return Figure(title="What a stricter limit costs", png=png(made), reading=sentence(*told))
