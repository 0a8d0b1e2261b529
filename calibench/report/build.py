"""The report: every section that has something to say, in its order, in one HTML file that needs nothing beside it."""

from __future__ import annotations

import base64
from collections import Counter
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from .. import registry
from .draw import style
from .section import Badge, Section
from .story import Story

SECTIONS = "calibench.report.sections"


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """A section under its name (the anchor) and title."""

    name: str
    title: str
    section: Section


def build_report(story: Story) -> str:
    """HTML text of the whole report: no scripts, no links outside, images inline. The caller writes it to disk."""
    environment = Environment(loader=PackageLoader("calibench.report", "."), autoescape=True, undefined=StrictUndefined,
                              trim_blocks=True, lstrip_blocks=True)
    environment.filters["base64"] = lambda png: base64.b64encode(png).decode("ascii")
    environment.tests["badge"] = lambda cell: isinstance(cell, Badge)
    return environment.get_template("page.html").render(story=story, chapters=_chapters(story), tally=_tally(story))


def _chapters(story: Story) -> list[Chapter]:
    modules = {name: registry.load(SECTIONS, name) for name in registry.names(SECTIONS)}
    chapters = []
    with style():
        for name in sorted(modules, key=lambda n: modules[n].ORDER):
            section = modules[name].render(story)
            if section is not None:
                chapters.append(Chapter(name=name, title=modules[name].TITLE, section=section))
    return chapters


def _tally(story: Story) -> list[tuple[Badge, str]]:
    """Badges for the head of the page: how many limits passed, failed and were skipped, and how many frames were solved."""
    counts = Counter(verdict.status for verdict in story.verdicts)
    tally = [(Badge(status=status), f"{counts[status]} {text}") for status, text in
             (("pass", "within limits"), ("fail", "outside limits"), ("skipped", "not judged")) if counts[status]]
    if story.sky:
        solved = sum(sky.calibrated.status == "solved" for sky in story.sky)
        badge = Badge(status="pass" if solved == len(story.sky) else "fail")
        tally.append((badge, f"{solved} of {len(story.sky)} sky frames solved"))
    return tally
