"""The photon transfer series of the simulated camera."""

from __future__ import annotations

import dataclasses
from itertools import islice

import numpy as np

from calibench.session.render import frames_of
from calibench.simulate.camera import thesis_camera
from calibench.simulate.ladder import LightLadder
from calibench.simulate.session import emva_plan, render_session


def test_stack_stands_at_half_of_the_ladder():
    ladder = LightLadder(exposures_s=(0.01, 0.02, 0.03, 0.04), photons_per_px_s=1e5, frames=2, stack_frames=7)
    assert ladder.shots == ((0.01, 2), (0.02, 9), (0.03, 2), (0.04, 2))


def test_plan_goes_from_dark_to_saturation_lit_and_dark():
    camera, plan = thesis_camera(), emva_plan()
    short = dataclasses.replace(plan, ladder=dataclasses.replace(plan.ladder, exposures_s=(0.001, 0.03), stack_frames=0))
    rendered = list(render_session(camera, None, short, seed=1, observer_at=None))
    assert frames_of(plan) == 220 and len(rendered) == frames_of(short) == 8
    lit, dark = rendered[:4], rendered[4:]
    assert {r.frame.kind for r in lit} == {"flat"} and {r.frame.kind for r in dark} == {"dark"}
    sensor = camera.sensor
    expected = sensor.offset_dn + sensor.gain_dn_per_e * sensor.quantum_efficiency * lit[0].truth["photons_per_px"]
    assert abs(np.median(lit[0].frame.data) - expected) <= 1.0
    assert np.mean(lit[-1].frame.data == sensor.white_level_dn) > 0.5
    assert abs(np.median(dark[0].frame.data) - sensor.offset_dn) <= 1.0
    again = next(islice(render_session(camera, None, short, seed=1, observer_at=None), 2, None))
    assert np.array_equal(again.frame.data, rendered[2].frame.data)
