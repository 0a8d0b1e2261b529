"""The sections of the trials of the sky wing: what they read from a table, and that they keep silent without one."""

from io import BytesIO

import matplotlib.image
import numpy as np
import pytest

from calibench.records import CalibrationMap
from calibench.report.draw import style
from calibench.report.sections import _conditions, attitude_methods, false_match, identifiers
from calibench.report.story import Story
from calibench.validate.case import Trial
from calibench.validate.trials import attitude_methods as attitude_trial
from calibench.validate.trials import false_match as false_trial
from calibench.validate.trials import identifiers as identifier_trial

CONDITIONS = ("clean", "noise 1 px", "5 false", "20 % missing", "6 stars", "5 false, 30 % missing")


def story(**trials):
    return Story(title="t", why="w", created="", software="", calmap=CalibrationMap(image_size_px=(64, 48)), trials=trials)


def identifiers_trial():
    rows = [(c, name, 10, solved, 0, ms, 1.5, 0.2) for c in CONDITIONS
            for name, solved, ms in (("pattern", 100.0, 0.3), ("grid", 80.0 if c == "6 stars" else 100.0, 2.0))]
    return Trial(name="identifiers", reading="all of them", columns=identifier_trial.COLUMNS, rows=tuple(rows))


def attitude_methods_trial():
    rows = [(c, name, 10, 10, cross, 20.0, 1.1, 0.2) for c in CONDITIONS
            for name, cross in (("quest", 3.5), ("svd", 3.5), ("triad", 25.0))]
    return Trial(name="attitude_methods", reading="all of them", columns=attitude_trial.COLUMNS, rows=tuple(rows))


def false_match_trial():
    rows = [(kind, limit, 1000, right + wrong, wrong, wrong / 1000)
            for kind, right in ((false_trial.NOTHING, 0), (false_trial.PART, 500))
            for limit, wrong in ((0.1, 40), (0.01, 3), (1e-6, 0))]
    return Trial(name="false_match", reading="limits", columns=false_trial.COLUMNS, rows=tuple(rows))


@pytest.mark.parametrize(("module", "trial", "said"), [
    (identifiers, identifiers_trial(), ("0 wrong of 120 answers", "pattern solved most, 100 %", "the fastest was pattern")),
    (attitude_methods, attitude_methods_trial(), ("3.50 to 3.50 arcsec", "25 for triad", "1.1")),
    (false_match, false_match_trial(), ("40 wrong of 1000 sets", "50 % rightly answered"))])
def test_each_tells_what_its_trial_found(module, trial, said):
    assert module.render(story()) is None
    with style():
        section = module.render(story(**{trial.name: trial}))
    told = " ".join(figure.reading for figure in section.figures)
    assert all(text in told for text in said), told
    for figure in section.figures:
        image = matplotlib.image.imread(BytesIO(figure.png))
        assert image.shape[0] > 200 and np.ptp(image[..., :3]) > 0.5


def test_a_panel_varies_one_thing():
    panels = {panel.label: panel for panel in _conditions.varied(identifiers_trial())}
    assert panels["centroid noise (px)"].values == (0.2, 1.0) and panels["part of the stars missing (%)"].values == (0.0, 20.0)
    assert all("5 false, 30 % missing" not in panel.names for panel in panels.values())


def test_a_wrong_answer_is_told():
    trial = identifiers_trial()
    rows = (trial.rows[0], ("clean", "grid", 10, 100.0, 2, 1.0, 1.5, 0.2), *trial.rows[2:])
    with style():
        section = identifiers.render(story(identifiers=Trial(name="identifiers", reading="", columns=trial.columns, rows=rows)))
    assert "2 wrong" in section.figures[0].reading
