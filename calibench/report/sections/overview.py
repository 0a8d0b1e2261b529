"""Overview: what was asked and found, whether it is good enough, under which conditions, and what to beware of."""

from __future__ import annotations

from collections import Counter

from ...calmap.assemble import LAYER_GROUPS
from ...records import Conditions, Limit, Verdict
from ..numbers import number, percent, plural, stated, with_uncertainty
from ..section import Badge, Section, Table
from ..story import ShotStory, Story

ORDER = 10
TITLE = "Overview"


def render(story: Story) -> Section:
    tables = [_verdicts(story.verdicts), _shots(story.shots), _camera(story), _timings(story)]
    return Section(paragraphs=(_summary(story),), warnings=_warnings(story), tables=tuple(t for t in tables if t is not None))


def _summary(story: Story) -> str:
    counts = Counter(v.status for v in story.verdicts)
    layers = [group for group, names in LAYER_GROUPS.items() if story.calmap.measured.intersection(names)]
    said = [f"Measured layers of the map: {', '.join(layers) or 'none'}."]
    if story.verdicts:
        said.append(f"Of {plural(len(story.verdicts), 'limit')}, {counts['pass']} passed, {counts['fail']} failed and "
                    f"{counts['skipped']} could not be judged (skipped).")
    if story.sky:
        raw, whole = (sum(getattr(s, which).status == "solved" for s in story.sky) for which in ("raw", "calibrated"))
        said.append(f"Of {plural(len(story.sky), 'sky frame')}, {raw} solved without the map and {whole} with it.")
    return " ".join(said)


def _warnings(story: Story) -> tuple[str, ...]:
    """Failed limits first, then what the measurements and the map have to say, each once."""
    failed = [f"{v.limit.measurement}.{v.limit.quantity}: {v.reason}" for v in story.verdicts if v.status == "fail"]
    said = [f"{m.name}: {text}" for m in story.measurements.values() for text in m.warnings]
    rejected = [f"{m.name}: {file} was not used: {why}" for m in story.measurements.values() for file, why in m.frames_rejected]
    return tuple(dict.fromkeys([*failed, *story.calmap.warnings, *said, *rejected]))


def _camera(story: Story) -> Table:
    camera = story.calmap.camera
    w, h = story.calmap.image_size_px
    rows = [("Camera", camera.name), ("Serial", camera.serial), ("Sensor", camera.sensor), ("Lens", camera.lens),
            ("Image size", f"{w} × {h} px"),
            ("Pixel size", f"{stated(camera.pixel_size_um)} µm" if camera.pixel_size_um else ""),
            *_conditions(story.calmap.conditions)]
    return Table(title="Camera and conditions", columns=("What", "Value"),
                 rows=tuple((what, value or "not stated") for what, value in rows))


def _conditions(conditions: Conditions) -> list[tuple[str, str]]:
    def between(pair: tuple | None, unit: str) -> str:
        if pair is None:
            return ""
        low, high = (stated(end) if isinstance(end, int | float) else end for end in pair)
        return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
    return [("Exposure", between(conditions.exposure_s, "s")), ("Temperature", between(conditions.temperature_c, "°C")),
            ("Gain setting", stated(conditions.gain_setting) if conditions.gain_setting is not None else ""),
            ("Bit depth", f"{conditions.bit_depth} bit" if conditions.bit_depth else ""),
            ("Taken (UTC)", between(conditions.date_obs, "").strip())]


def _shots(shots: tuple[ShotStory, ...]) -> Table | None:
    rows = tuple((shot.name, shot.what, shot.why, str(shot.wanted), str(shot.found), Badge(status=shot.status),
                  "; ".join(shot.remarks)) for shot in shots)
    columns = ("Shots", "What", "Why", "Wanted", "Found", "Status", "Remarks")
    return Table(title="Session", columns=columns, rows=rows, numbers=frozenset({"Wanted", "Found"})) if rows else None


def _verdicts(verdicts: tuple[Verdict, ...]) -> Table | None:
    rows = tuple((f"{v.limit.measurement}.{v.limit.quantity}", with_uncertainty(v.value, v.uncertainty), _bounds(v.limit),
                  v.limit.unit, Badge(status=v.status), v.reason, v.limit.why) for v in verdicts)
    columns = ("Quantity", "Value ± 1σ", "Limit", "Unit", "Verdict", "Reason", "Why this limit")
    return Table(title="Verdicts", columns=columns, rows=rows, numbers=frozenset({"Value ± 1σ", "Limit"})) if rows else None


def _bounds(limit: Limit) -> str:
    if limit.minimum is None:
        return f"≤ {stated(limit.maximum)}"
    if limit.maximum is None:
        return f"≥ {stated(limit.minimum)}"
    return f"{stated(limit.minimum)} … {stated(limit.maximum)}"


def _timings(story: Story) -> Table | None:
    total = sum(story.seconds.values())
    if not total:
        return None
    rows = [(step, number(seconds, 3), percent(seconds / total)) for step, seconds in story.seconds.items()]
    return Table(title="Time spent", columns=("Step", "Time (s)", "Share"), rows=(*rows, ("all", number(total, 3), percent(1))),
                 numbers=frozenset({"Time (s)", "Share"}))
