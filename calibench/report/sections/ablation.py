"""Ablation: what each layer of the map earned on the sky frames."""

from __future__ import annotations

from ..draw import BLUE, FAINT, GREY, INK, ORANGE, WIDE, png, sheet
from ..numbers import MISSING, number, sentence
from ..section import Figure, Section, Table
from ..story import Story

ORDER = 70
TITLE = "What each layer earned"
UNITS = ("_px", "_arcsec")


def render(story: Story) -> Section | None:
    trial = story.trials.get("ablation")
    if trial is None or not trial.rows:
        return None
    heads = tuple(_head(column) for column in trial.columns)
    rows = tuple(tuple(_cell(value) for value in row) for row in trial.rows)
    table = Table(title="The same frames solved with parts of the map", columns=heads, rows=rows, numbers=frozenset(heads[1:]),
                  note="Earned: error without the layer minus error with the whole map; negative: the layer does harm here.")
    figure = _earned(trial.columns, trial.rows)
    return Section(paragraphs=(f"{trial.reading[:1].upper()}{trial.reading[1:]}.",), tables=(table,),
                   figures=(figure,) if figure else ())


def _head(column: str) -> str:
    unit = next((unit for unit in UNITS if column.endswith(unit)), "")
    name = column.removesuffix(unit).replace("_", " ")
    name = f"{name[:1].upper()}{name[1:]}"
    return f"{name} ({unit[1:]})" if unit else name


def _cell(value: object) -> str:
    if isinstance(value, str):
        return value
    return MISSING if value is None else number(value, 4)


def _earned(columns: tuple[str, ...], rows: tuple[tuple, ...]) -> Figure | None:
    """Bars of arcseconds earned; None where nothing was (no frame solved both ways)."""
    at = columns.index("earned_arcsec")
    earned = sorted(((row[0], row[at]) for row in rows if row[at] is not None), key=lambda pair: pair[1])
    if not earned:
        return None
    made, (axes,) = sheet((WIDE[0], 1.2 + 0.32 * len(earned)))
    values = [value for _, value in earned]
    bars = axes.barh(range(len(earned)), values, color=[BLUE if v >= 0 else ORANGE for v in values],
                     hatch=["" if v >= 0 else "///" for v in values], edgecolor="white", height=0.62)
    axes.bar_label(bars, labels=[f"{number(v, 3)}" for v in values], padding=4, color=INK)
    axes.set_yticks(range(len(earned)), [name for name, _ in earned])
    axes.axvline(0, color=GREY, linewidth=0.8)
    axes.grid(axis="x", color=FAINT)
    axes.margins(x=0.12)
    largest = max(abs(v) for v in values)
    axes.set_xscale("symlog", linthresh=max(min(1.0, largest), 1e-3))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("earned by having it: rise of the error when it is left out (arcsec; linear below 1, logarithmic above)")
    return Figure(title="Arcseconds earned by each layer", png=png(made), reading=_reading(earned), wide=True)


def _reading(earned: list[tuple[str, float]]) -> str:
    """Which layer earns most, and which do harm; earned: (name, arcsec), least first."""
    layers = [(name.removeprefix("without "), value) for name, value in earned if name.startswith("without ")]
    whole = [f"the whole map earns {number(value, 3)} arcsec over {name}" for name, value in earned if name == "no map"]
    best = [f"of its layers {layers[-1][0]} earns most, {number(layers[-1][1], 3)} arcsec"] if layers else []
    harm = [f"{name} ({number(value, 2)} arcsec)" for name, value in layers if value < 0]
    return sentence(*whole, *best, f"the error falls without {' or '.join(harm)}" if harm else "no layer does harm")
