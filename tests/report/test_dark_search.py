"""The dark section on a whole measurement: each figure says what it shows."""

from __future__ import annotations

import dataclasses

import numpy as np

from calibench.calmap.assemble import assemble
from calibench.calmap.thermal import warming
from calibench.measure import dark
from calibench.records import Frame
from calibench.report.draw import style
from calibench.report.numbers import with_uncertainty
from calibench.report.sections import dark as section
from calibench.report.story import Story

SHAPE = (64, 96)


def test_null_temperatures_and_telegraph_pixels_are_drawn_and_read():
    rng = np.random.default_rng(1)
    frames = []
    for celsius in (5.0, 20.0):
        rate = 30 * float(warming(celsius, 20.0, 0.6)) * np.ones(SHAPE)
        rate[10, 20] += 200
        for t in (0.1, 2.0):
            for i in range(16):
                charge = rng.poisson(rate * t) + rng.normal(0, 4, SHAPE)
                charge[30, 40] += 200 * (i % 3 == 0)
                frames.append(Frame(data=np.rint(100 + 0.5 * charge).clip(0).astype(np.uint16), kind="dark", bit_depth=12,
                                    white_level_dn=4095, exposure_s=t, temperature_c=celsius, egain_e_per_dn=2.0,
                                    file=f"{celsius}/{t}/{i}"))
    measurement = dark.measure(frames)
    calmap = assemble([measurement], software="s", created="2025-01-01T00:00:00")
    story = Story(title="t", why="w", created="c", software="s", calmap=calmap, measurements={"dark": measurement})
    with style():
        made = section.render(story)
        bare = section.render(dataclasses.replace(story, measurements={"dark": dataclasses.replace(measurement, evidence={})}))
    readings = {figure.title: figure.reading for figure in made.figures}
    assert "found in 99 %" in readings["Normal pixels and the threshold"]
    energy = measurement.quantity("dark_activation_ev")
    said = f"Activation energy {with_uncertainty(energy.value, energy.uncertainty)} eV"
    assert said in readings["Dark current against temperature"]
    assert "1 pixel jump" in readings["Telegraph pixels, frame by frame"]
    counts = next(table for table in made.tables if table.title.startswith("Hot pixels at each"))
    assert len(counts.rows) == 4 and {row[1] for row in counts.rows} == {"5", "20"}
    assert not {figure.title for figure in bare.figures} & readings.keys() - {"Offset", "Dark rate", "Dark rates of all pixels",
                                                                               "Where the hot pixels are"}
