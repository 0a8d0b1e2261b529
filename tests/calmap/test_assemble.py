"""Measurements to a map: names, replacement by groups, contradictions, and the map without a layer."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.calmap.assemble import LAYER_GROUPS, assemble, without_layer
from calibench.errors import BadInput
from calibench.records import (
    DEFECT_FLAGS,
    IMAGE_LAYERS,
    LAYERS,
    CalibrationMap,
    Camera,
    Intrinsics,
    Limit,
    Measurement,
    Provenance,
    PsfMap,
    Quantity,
    Verdict,
)

SIZE = (5, 4)
SHAPE = (4, 5)
STAMP = {"software": "calibench 0.1.0", "created": "2024-01-01T00:00:00Z"}


def dark(**changes) -> Measurement:
    defects = np.zeros(SHAPE, np.uint16)
    defects[0, 0] = DEFECT_FLAGS["hot"]
    conditions = {"exposure_s": (0.1, 2.0), "temperature_c": (20.0, 20.5), "gain_setting": 16.0, "bit_depth": 10,
                  "date_obs": ("2024-01-01T00:00:00", "2024-01-01T00:10:00"), "camera": "MT9V022"}
    return Measurement(**{
        "name": "dark", "image_size_px": SIZE, "quantities": (Quantity(name="offset_dn", value=64.0, unit="DN"),),
        "maps": {"offset_dn": np.full(SHAPE, 64.0), "dark_rate_dn_per_s": np.full(SHAPE, 3.0), "defects": defects},
        "evidence": {"ladder_s": np.array([0.1, 2.0])}, "warnings": ("the temperature drifts",),
        "provenance": Provenance(inputs={"d1.png": "aa"}, settings={"hot": 20.0}, conditions=conditions)} | changes)


def flat(**changes) -> Measurement:
    defects = np.zeros(SHAPE, np.uint16)
    defects[0, 0], defects[1, 1] = DEFECT_FLAGS["cold"], DEFECT_FLAGS["dead"]
    conditions = {"exposure_s": (0.05, 0.05), "temperature_c": (21.0, 21.0), "gain_setting": 16.0, "bit_depth": 10}
    return Measurement(**{
        "name": "flat", "image_size_px": SIZE, "maps": {"response": np.full(SHAPE, 1.01), "defects": defects},
        "layers": {"gain_dn_per_e": 0.1}, "provenance": Provenance(conditions=conditions)} | changes)


def lens() -> Measurement:
    intrinsics = Intrinsics.pinhole(focal_px=900.0, image_size_px=SIZE, focal_sd_px=1.0)
    return Measurement(name="intrinsics", image_size_px=SIZE, intrinsics=intrinsics,
                       provenance=Provenance(conditions={"bit_depth": 8}))


def with_conditions(measurement: Measurement, **changes) -> Measurement:
    conditions = dict(measurement.provenance.conditions) | changes
    return dataclasses.replace(measurement, provenance=Provenance(conditions=conditions))


def test_everything_finds_its_place():
    calmap = assemble([dark(), flat(), lens()], camera=Camera(name="A"), protocol_sha256="ff", **STAMP)
    assert calmap.measured == {"offset_dn", "dark_rate_dn_per_s", "response", "defects", "gain_dn_per_e", "intrinsics"}
    assert calmap.offset_dn[0, 0] == 64 and calmap.gain_dn_per_e == 0.1 and calmap.intrinsics.fx_px == 900
    assert calmap.quantities["dark.offset_dn"].value == 64.0
    assert list(calmap.evidence) == ["dark/ladder_s"] and calmap.inputs == {"dark/d1.png": "aa"}
    assert calmap.settings["dark"] == {"hot": 20.0} and calmap.warnings == ("dark: the temperature drifts",)
    assert (calmap.camera.name, calmap.protocol_sha256, calmap.software) == ("A", "ff", "calibench 0.1.0")


def test_defects_are_ored():
    calmap = assemble([dark(), flat()], **STAMP)
    assert calmap.defects[0, 0] == DEFECT_FLAGS["hot"] | DEFECT_FLAGS["cold"] | DEFECT_FLAGS["cluster"]
    assert calmap.defects[1, 1] == DEFECT_FLAGS["dead"] | DEFECT_FLAGS["cluster"] and np.count_nonzero(calmap.defects) == 2


def test_conditions_are_the_span_of_all():
    conditions = assemble([dark(), flat(), lens()], **STAMP).conditions
    assert conditions.exposure_s == (0.05, 2.0) and conditions.temperature_c == (20.0, 21.0)
    assert conditions.gain_setting == 16.0 and conditions.date_obs == ("2024-01-01T00:00:00", "2024-01-01T00:10:00")
    assert conditions.camera == "MT9V022"
    assert conditions.bit_depth == 10  # the 8-bit board views say nothing of the converter


@pytest.mark.parametrize("other", [
    with_conditions(flat(), gain_setting=32.0), with_conditions(flat(), bit_depth=12),
    with_conditions(lens(), camera="another"),
    Measurement(name="psf", image_size_px=(4, 4)),
], ids=["gain", "bit depth", "camera", "size"])
def test_contradictions_are_refused_and_say_who(other):
    with pytest.raises(BadInput, match=f"contradict: dark .*{other.name}"):
        assemble([dark(), other], **STAMP)
    with pytest.raises(BadInput, match="contradict: the base map"):
        assemble([other], base=assemble([dark()], **STAMP), **STAMP)


def test_the_base_keeps_what_is_not_measured_anew():
    base = assemble([dark(), flat()], camera=Camera(name="A", lens="8.5 mm"), **STAMP)
    calmap = assemble([lens()], base=base, camera=Camera(serial="7"), **STAMP)
    assert calmap.measured == base.measured | {"intrinsics"}
    np.testing.assert_array_equal(calmap.defects, base.defects)
    assert calmap.quantities == base.quantities and calmap.warnings == base.warnings
    assert calmap.camera == Camera(name="A", lens="8.5 mm", serial="7")


def test_a_measurement_made_anew_replaces_its_own():
    limit = Limit(measurement="dark", quantity="offset_dn", maximum=70.0)
    other = Limit(measurement="flat", quantity="x", maximum=70.0)
    base = dataclasses.replace(assemble([dark(), flat()], **STAMP),
                               verdicts=(Verdict(limit=limit, status="pass"), Verdict(limit=other, status="skipped")))
    again = dark(quantities=(), evidence={}, warnings=(), provenance=Provenance(),
                 maps={"offset_dn": np.full(SHAPE, 65.0)})
    calmap = assemble([again], base=base, **STAMP)
    assert calmap.offset_dn[0, 0] == 65.0
    # The dark rate of the base belonged to the old offset.
    assert "dark_rate_dn_per_s" not in calmap.measured and not calmap.dark_rate_dn_per_s.any()
    assert "response" in calmap.measured and calmap.defects[0, 0] & DEFECT_FLAGS["hot"]
    assert not calmap.quantities and not calmap.evidence and not calmap.inputs and calmap.warnings == ()
    assert [v.limit.measurement for v in calmap.verdicts] == ["flat"]


def test_a_name_that_begins_like_another_is_not_replaced_with_it():
    base = assemble([dark(name="dark_cold")], **STAMP)
    calmap = assemble([dark()], base=base, **STAMP)
    assert {"dark_cold.offset_dn", "dark.offset_dn"} == calmap.quantities.keys()


def test_two_measurements_of_one_layer_are_said():
    transfer = Measurement(name="transfer", image_size_px=SIZE, layers={"gain_dn_per_e": 0.2})
    calmap = assemble([flat(), transfer], **STAMP)
    assert calmap.gain_dn_per_e == 0.2 and any("transfer" in w and "gain_dn_per_e" in w for w in calmap.warnings)


def test_a_scalar_that_is_not_finite_is_not_measured():
    calmap = assemble([flat(layers={"gain_dn_per_e": np.nan, "saturation_dn": np.inf})], **STAMP)
    assert not {"gain_dn_per_e", "saturation_dn"} & calmap.measured and np.isnan(calmap.gain_dn_per_e)


def test_pixels_that_are_not_finite_take_the_median_and_a_flag():
    offset = np.full(SHAPE, 64.0)
    offset[2, 3] = np.nan
    calmap = assemble([dark(maps={"offset_dn": offset})], **STAMP)
    assert calmap.offset_dn[2, 3] == 64.0 and calmap.defects[2, 3] == DEFECT_FLAGS["unmeasured"]
    assert np.count_nonzero(calmap.defects) == 1 and "1 pixels of offset_dn" in calmap.warnings[-1]


def test_an_uncertainty_that_nobody_knows_is_left_out_and_said():
    # One frame at each exposure: an offset, but no scatter to judge it by.
    maps = {"offset_dn": np.full(SHAPE, 64.0), "offset_uncertainty_dn": np.full(SHAPE, np.nan)}
    calmap = assemble([dark(maps=maps)], **STAMP)
    assert calmap.measured == {"offset_dn"} and "offset_uncertainty_dn" in calmap.warnings[-1]


@pytest.mark.parametrize("measurements", [
    [], [dark(), dark()], [dark(maps={"shading": np.ones(SHAPE)})], [dark(maps={"offset_dn": np.full(SHAPE, np.nan)})],
    [dark(maps={"offset_dn": np.ones((5, 4))})],
], ids=["nothing", "twice", "unknown layer", "no finite pixel", "turned"])
def test_bad_measurements_are_refused(measurements):
    with pytest.raises(BadInput):
        assemble(measurements, **STAMP)


def test_another_camera_is_refused():
    base = assemble([dark()], camera=Camera(name="A"), **STAMP)
    with pytest.raises(BadInput, match="camera identities"):
        assemble([flat()], base=base, camera=Camera(name="B"), **STAMP)


@pytest.fixture
def everything() -> CalibrationMap:
    rng = np.random.default_rng(1)
    return CalibrationMap(
        image_size_px=SIZE, measured=frozenset(LAYERS), **{n: rng.normal(2, 0.1, SHAPE) for n in IMAGE_LAYERS},
        defects=np.full(SHAPE, 2), gain_dn_per_e=0.1, saturation_dn=1000.0,
        intrinsics=lens().intrinsics, psf=PsfMap.unknown(SIZE, sigma_px=3.0))


@pytest.mark.parametrize("group", LAYER_GROUPS)
def test_without_a_layer_only_that_layer_is_its_identity(everything, group):
    reduced, identity = without_layer(everything, group), CalibrationMap(image_size_px=SIZE)
    assert everything.measured - reduced.measured == set(LAYER_GROUPS[group])
    for name in LAYERS:
        expected = getattr(identity if name in LAYER_GROUPS[group] else everything, name)
        found = getattr(reduced, name)
        if name == "intrinsics":
            assert found.fx_px == expected.fx_px
        elif name == "psf":
            np.testing.assert_array_equal(found.coefficients, expected.coefficients)
        else:
            np.testing.assert_array_equal(found, expected)


def test_groups_cover_every_layer_once_and_an_unknown_one_is_refused(everything):
    assert sorted(name for group in LAYER_GROUPS.values() for name in group) == sorted(LAYERS)
    with pytest.raises(BadInput, match="choose one of: dark"):
        without_layer(everything, "offset")
