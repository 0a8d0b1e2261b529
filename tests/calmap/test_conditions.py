"""Is a frame within what the map was measured under? What contradicts, and what could not be checked."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.calmap.conditions import agreed, unchecked_conditions
from calibench.calmap.correct import correct, outside_conditions
from calibench.errors import BadInput
from calibench.records import CalibrationMap, Camera, Conditions, Frame

CONDITIONS = Conditions(exposure_s=(0.1, 2.0), temperature_c=(19.0, 21.0), gain_setting=16.0)


def dark_map(layer="offset_dn", **changes) -> CalibrationMap:
    return CalibrationMap(**{"image_size_px": (4, 3), "measured": frozenset([layer]), "conditions": CONDITIONS,
                             "camera": Camera(name="Cam A", serial="S7")} | changes)


def frame_with(**changes) -> Frame:
    return Frame(**{"data": np.zeros((3, 4), np.uint16), "bit_depth": 10, "white_level_dn": 1023.0, "exposure_s": 1.0,
                    "temperature_c": 20.0, "gain_setting": 16.0, "camera": "cam a "} | changes)


@pytest.mark.parametrize("changes", [
    {}, {"exposure_s": 2.1}, {"exposure_s": 0.095}, {"temperature_c": 17.0}, {"temperature_c": 23.0}, {"camera": "s7"},
    {"exposure_s": None, "temperature_c": None, "gain_setting": None, "camera": None},
])
def test_a_frame_within_the_margins_or_silent_contradicts_nothing(changes):
    assert outside_conditions(frame_with(**changes), dark_map()) == ()


@pytest.mark.parametrize(("changes", "word"), [
    ({"exposure_s": 2.2}, "exposure 2.2 s"), ({"exposure_s": 0.09}, "exposure"),
    ({"temperature_c": 16.9}, "temperature"), ({"temperature_c": 23.1}, "temperature 23.1 C"),
    ({"gain_setting": 17.0}, "gain setting 17"), ({"camera": "Cam B"}, "Cam B"),
])
def test_each_contradiction_is_one_sentence(changes, word):
    sentences = outside_conditions(frame_with(**changes), dark_map())
    assert len(sentences) == 1 and word in sentences[0]


def test_exposure_and_temperature_do_not_bind_a_map_without_dark():
    frame = frame_with(exposure_s=60.0, temperature_c=-20.0)
    assert len(outside_conditions(frame, dark_map())) == 2
    assert outside_conditions(frame, dark_map(layer="response")) == ()


def test_the_camera_is_known_by_what_its_frames_call_it():
    calmap = dark_map(conditions=Conditions(camera="MT9V022"), camera=Camera(name="the blue one"))
    for name in ("mt9v022", "The Blue One"):
        assert outside_conditions(frame_with(camera=name), calmap) == ()
    assert "MT9V022" in outside_conditions(frame_with(camera="MT9V024"), calmap)[0]
    assert unchecked_conditions(frame_with(), dark_map(conditions=Conditions(camera="x"), camera=Camera())) == ()


def test_what_could_not_be_checked_becomes_a_warning_of_the_corrected_frame():
    frame = frame_with(camera=None, gain_setting=None, temperature_c=None)
    sentences = unchecked_conditions(frame, dark_map())
    assert len(sentences) == 3
    assert "camera" in sentences[0] and "gain setting" in sentences[1] and "temperature" in sentences[2]
    assert correct(frame, dark_map()).warnings == sentences
    assert "the map" in unchecked_conditions(frame_with(), dark_map(camera=Camera()))[0]
    assert unchecked_conditions(frame_with(), dark_map()) == ()


def test_agreement():
    assert agreed("x", {}) is None and agreed("x", {"a": None, "b": 3}) == 3
    with pytest.raises(BadInput, match="x contradict: a has 1, b has 2"):
        agreed("x", {"a": 1, "b": 2, "c": None})
