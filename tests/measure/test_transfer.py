"""Photon transfer against simulated truth, and its parts against plain numpy."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from calibench.calmap.correct import correct
from calibench.errors import BadInput
from calibench.io.descriptor import described_frames, read_descriptor
from calibench.measure import transfer
from calibench.measure._gain import known_gain
from calibench.measure._photon import kernels, levels
from calibench.records import CalibrationMap, Frame


def values(measurement):
    return {q.name: q for q in measurement.quantities}


@pytest.fixture(scope="module")
def measured(light_ladder):
    return transfer.measure(light_ladder(1, size_px=(240, 160), levels=25))


TRUTH = {"gain_dn_per_e": 0.25, "gain_e_per_dn": 4.0, "responsivity_dn_per_photon": 0.15, "quantum_efficiency_percent": 60.0,
         "read_noise_e": 4.0, "read_noise_dn": 1.0, "offset_dn": 60.0, "dark_current_e_per_s": 20.0,
         "dark_current_from_variance_e_per_s": 20.0, "dsnu_raw_pixel_e": 3.0, "dsnu_raw_row_e": 1.0, "dsnu_raw_column_e": 1.5,
         "dsnu_raw_e": math.sqrt(3**2 + 1 + 1.5**2), "prnu_raw_pixel_percent": 1.0, "prnu_raw_row_percent": 0.4,
         "prnu_raw_column_percent": 0.3, "absolute_threshold_e": math.sqrt(16 + 4 / 3 + 0.25) + 0.5,
         "noise_correlation_x": 0.0, "noise_correlation_y": 0.0, "linearity_error_percent": 0.0}


@pytest.mark.parametrize("name", TRUTH)
def test_truth_lies_within_the_errors(measured, name):
    q = measured.quantity(name)
    assert abs(q.value - TRUTH[name]) < 4 * q.uncertainty


def test_errors_are_small_enough_to_say_something(measured):
    largest = {"gain_dn_per_e": 0.002, "quantum_efficiency_percent": 0.002, "read_noise_e": 0.006, "dsnu_raw_pixel_e": 0.005,
               "prnu_raw_pixel_percent": 0.005}
    for name, relative in largest.items():
        q = measured.quantity(name)
        assert q.uncertainty < relative * q.value, name


def test_every_figure_has_unit_source_and_uncertainty_or_a_reason(measured):
    for q in measured.quantities:
        assert q.unit and q.source and q.symbol
        assert (q.value is not None and math.isfinite(q.value) and q.uncertainty > 0) or q.reason, q.name
    json.dumps([q.as_json() for q in measured.quantities], allow_nan=False)


def test_capacity_is_the_last_level_before_pixels_clip(measured):
    photons = measured.evidence["light"]
    at = int(np.searchsorted(photons, measured.quantity("saturation_photons").value))
    shares = measured.evidence["at_top"]
    assert shares[at] <= 0.002 < shares[at + 1]
    q = values(measured)
    assert q["snr_max"].value == pytest.approx(math.sqrt(q["saturation_e"].value))
    assert q["dynamic_range_db"].value == pytest.approx(
        20 * math.log10(q["saturation_e"].value / q["absolute_threshold_e"].value), abs=1e-9)
    assert measured.layers["saturation_dn"] == 4095


def test_defects_raise_the_standard_figure_and_not_the_core(light_ladder):
    def with_hot():
        for frame in light_ladder(3, stack=10):
            data = frame.data.copy()
            data[::32, ::32] = np.minimum(data[::32, ::32] + 100, 4095)
            yield dataclasses.replace(frame, data=data)
    q = values(transfer.measure(with_hot()))
    assert q["dsnu_1288_e"].value > 10
    assert q["dsnu_core_e"].value == pytest.approx(3.5, rel=0.15)


def test_a_negative_variance_is_given_as_zero_and_kept(light_ladder):
    q = values(transfer.measure(light_ladder(4, dsnu=(0, 0, 0), prnu=(0, 0, 0), stack=4)))
    parts = [q[f"{what}_{kind}_{part}_{unit}"] for what, unit in (("dsnu", "e"), ("prnu", "percent"))
             for kind in ("1288", "raw") for part in ("row", "column", "pixel")]
    negative = [p for p in parts if "negative variance" in p.reason]
    assert negative and all(p.value == 0 and p.uncertainty > 0 for p in negative)


def test_quiet_sensor_gives_an_upper_limit(light_ladder):
    q = values(transfer.measure(light_ladder(5, read_e=0.4, stack=0)))
    assert q["dark_noise_dn"].value == 0.49 and "upper limit" in q["dark_noise_dn"].reason


def test_planes_of_a_mosaic_are_measured_apart(light_ladder):
    def coloured():
        for frame in light_ladder(6, size_px=(96, 64), bayer="GRBG", dsnu=(0, 0, 0), prnu=(0.005, 0, 0)):
            data = frame.data.astype(float)
            data[1::2, 0::2] = 60 + (data[1::2, 0::2] - 60) * 0.5  # blue answers half as strongly, by its converter
            yield dataclasses.replace(frame, data=np.rint(data).astype(np.uint16))
    q = values(transfer.measure(coloured()))
    for plane, gain in (("gr", 0.25), ("r", 0.25), ("b", 0.125), ("gb", 0.25)):
        assert q[f"gain_dn_per_e_{plane}"].value == pytest.approx(gain, rel=0.05)
        assert q[f"prnu_raw_percent_{plane}"].value == pytest.approx(0.5, abs=5 * q[f"prnu_raw_percent_{plane}"].uncertainty)
    assert q["gain_dn_per_e"].value == pytest.approx(np.mean([q[f"gain_dn_per_e_{p}"].value for p in ("gr", "r", "b", "gb")]))


def test_order_of_the_frames_and_memory_do_not_matter(light_ladder, monkeypatch):
    frames = list(light_ladder(7, levels=10, stack=0))
    one = transfer.measure(frames)
    mixed = transfer.measure(frames[::2] + frames[1::2])
    monkeypatch.setattr(levels, "OPEN_BYTES", 3 * frames[0].data.nbytes)
    thrifty = transfer.measure(frames)
    for other in (mixed, thrifty):
        for a, b in zip(one.quantities, other.quantities, strict=True):
            assert a.value == b.value or a.value == pytest.approx(b.value, rel=1e-9, abs=1e-9), a.name


def test_levels_of_one_exposure_are_told_apart_by_their_light(light_ladder):
    frames = [dataclasses.replace(f, exposure_s=0.01, photons_per_px=None) for f in light_ladder(8, stack=0, rate_e_per_s=0.0)]
    measured = transfer.measure(frames)
    assert len(measured.evidence["signal_dn"]) >= 18
    assert measured.quantity("gain_dn_per_e").value == pytest.approx(0.25, rel=0.02)
    assert "photons" in measured.quantity("quantum_efficiency_percent").reason
    assert measured.quantity("linearity_error_percent").value is None


def test_without_exposures_rates_are_left_out_with_the_reason(light_ladder):
    frames = [dataclasses.replace(f, exposure_s=None) for f in light_ladder(9, stack=0, rate_e_per_s=0.0)]
    q = values(transfer.measure(frames))
    assert q["dark_current_e_per_s"].value is None and "exposure unknown" in q["dark_current_e_per_s"].reason
    assert q["quantum_efficiency_percent"].value == pytest.approx(60, abs=5 * q["quantum_efficiency_percent"].uncertainty)


def test_irradiance_in_place_of_photons(light_ladder):
    frames = [dataclasses.replace(f, photons_per_px=None) for f in light_ladder(10, stack=0)]
    full_photons = 1.1 * (4095 - 60) / 0.25 / 0.6
    q = values(transfer.measure(frames, transfer.Settings(irradiance_photons_per_px_s=full_photons / 0.02, lens="no")))
    assert q["quantum_efficiency_percent"].value == pytest.approx(60, abs=5 * q["quantum_efficiency_percent"].uncertainty)


def test_saturation_that_was_not_reached_is_null_with_a_lower_bound(light_ladder):
    measured = transfer.measure(light_ladder(11, reach=0.8, stack=0))
    q = values(measured)
    assert all(q[n].value is None and "more than" in q[n].reason for n in ("saturation_e", "snr_max", "dynamic_range_db"))
    assert q["gain_dn_per_e"].value == pytest.approx(0.25, rel=0.02)
    assert "saturation_dn" not in measured.layers and any("not reached" in w for w in measured.warnings)


def test_a_full_well_below_the_converters_end(light_ladder):
    q = values(transfer.measure(light_ladder(12, well_e=9000.0, stack=0, levels=30)))
    step_e = 1.1 * (4095 - 60) / 0.25 / 30
    assert 9000 - 1.5 * step_e < q["saturation_e"].value < 9000 + 0.5 * step_e
    assert "fill before" in q["saturation_e"].reason


def test_crosstalk_is_said_and_taken_out_of_the_gain(light_ladder):
    measured = transfer.measure(light_ladder(13, share=0.05, size_px=(192, 128), stack=0))
    rho = measured.quantity("noise_correlation_x")
    assert rho.value == pytest.approx(0.05 * 0.95 / (0.95**2 + 0.05**2), abs=4 * rho.uncertainty)
    assert any("correlated" in w for w in measured.warnings)
    raw, corrected = (measured.quantity(f"gain_{n}dn_per_e") for n in ("", "crosstalk_corrected_"))
    assert raw.value < 0.235 and abs(corrected.value - 0.25) < 3 * corrected.uncertainty < 0.012
    assert measured.layers["gain_dn_per_e"] == corrected.value
    both = CalibrationMap(image_size_px=(192, 128), gain_dn_per_e=corrected.value, measured=frozenset({"gain_dn_per_e"}),
                          quantities={f"transfer.{q.name}": q for q in (raw, corrected)})
    assert known_gain(both, next(light_ladder(13, stack=0))).uncertainty == corrected.uncertainty


def test_coupling_of_the_four_neighbours(light_ladder):
    measured = transfer.measure(light_ladder(23, coupling=0.02, size_px=(192, 128), stack=0))
    for axis in "xy":
        coupling = measured.quantity(f"crosstalk_{axis}_percent")
        assert abs(coupling.value - 2) < 3.5 * coupling.uncertainty < 0.4
    corrected = measured.quantity("gain_crosstalk_corrected_dn_per_e")
    assert abs(corrected.value - 0.25) < 3 * corrected.uncertainty


def test_rows_that_jitter_are_no_crosstalk(light_ladder):
    """Their noise is the dark's; taken off, the photon noise is as white as it was."""
    rng = np.random.default_rng(24)
    jitter = (dataclasses.replace(f, data=(f.data + np.rint(rng.normal(0, 3, (len(f.data), 1)))).astype(np.uint16))
              for f in light_ladder(24, size_px=(192, 128), stack=0, offset_dn=90.0, reach=0.9))
    measured = transfer.measure(jitter)
    assert measured.quantity("gain_crosstalk_corrected_dn_per_e").value is None
    rho = measured.quantity("noise_correlation_x")
    assert abs(rho.value) < 5 * rho.uncertainty


def test_image_lag_is_said(light_ladder, measured):
    late = measured.quantity("frame_correlation")
    assert abs(late.value) < 3 * late.uncertainty
    lagging = transfer.measure(light_ladder(25, lag=0.05, size_px=(192, 128), levels=14))
    rho = lagging.quantity("frame_correlation")
    assert rho.value == pytest.approx(0.05 * 0.95 / (0.95**2 + 0.05**2), abs=3.5 * rho.uncertainty)
    assert any("image lag" in w for w in lagging.warnings)


def test_flicker_is_said_and_taken_off(light_ladder):
    measured = transfer.measure(light_ladder(14, flicker=0.01, stack=0, levels=30))
    assert any("flickers" in w for w in measured.warnings)
    assert measured.quantity("gain_dn_per_e").value == pytest.approx(0.25, rel=0.03)


def test_a_bent_response_is_corrected_by_the_map_and_a_straight_one_left_alone(light_ladder, measured):
    assert "linearity_dn" not in measured.layers
    bent = transfer.measure(light_ladder(15, bend=0.04, levels=40, stack=0))
    curve = bent.layers["linearity_dn"]
    assert bent.quantity("linearity_error_percent").value > 0.5
    calmap = CalibrationMap(image_size_px=(40, 30), linearity_dn=curve, gain_dn_per_e=0.25,
                            read_noise_dn=np.full((30, 40), 1.0),
                            measured=frozenset({"linearity_dn", "gain_dn_per_e", "read_noise_dn"}))
    light_e = np.array([2000.0, 4000, 8000, 14000])
    dn = 0.25 * light_e * (1 - 0.04 * light_e / (4035 / 0.25))
    shown = [correct(Frame(data=np.full((30, 40), v, np.float32), bit_depth=12, white_level_dn=4095), calmap) for v in dn]
    ratio = np.array([c.signal_dn[0, 0] for c in shown]) / light_e
    assert np.ptp(dn / light_e) / np.mean(dn / light_e) > 0.025
    assert np.ptp(ratio) / np.mean(ratio) < 0.003
    slope = (shown[1].variance_dn2[0, 0] - 0.25 * shown[1].signal_dn[0, 0]) ** 0.5
    step = correct(Frame(data=np.full((30, 40), dn[1] + 1, np.float32), bit_depth=12, white_level_dn=4095), calmap)
    assert slope == pytest.approx(step.signal_dn[0, 0] - shown[1].signal_dn[0, 0], rel=0.01)


def test_few_distinct_levels_scatter_widens_the_error(light_ladder):
    """Where the levels do not lie on a line, every level counts alike and the scatter sets the error."""
    straight = transfer.measure(light_ladder(16, stack=0, levels=40)).quantity("gain_dn_per_e")
    bent = transfer.measure(light_ladder(16, stack=0, levels=40, bend=0.2)).quantity("gain_dn_per_e")
    assert "weighted" in straight.source and "every level alike" in bent.source
    assert bent.uncertainty > 2 * straight.uncertainty


def test_kernels_against_numpy():
    rng = np.random.default_rng(17)
    a, b = rng.integers(0, 65536, (2, 13, 17)).astype(np.uint16)
    d, s = b.astype(np.int64) - a, b.astype(np.int64) + a
    plain, squares, fourth, right, below, both, columns, rows = kernels.pair(a, b)
    assert (plain, squares, both) == (d.sum(), (d**2).sum(), (s**2).sum())
    assert fourth == pytest.approx(float((d.astype(float) ** 4).sum()))
    assert (right, below) == ((d[:, 1:] * d[:, :-1]).sum(), (d[1:] * d[:-1]).sum())
    assert np.array_equal(columns, s.sum(0)) and np.array_equal(rows, s.sum(1))
    assert kernels.top(a) == (a.max(), np.count_nonzero(a == a.max()))
    total = np.ones(a.shape, np.uint32)
    assert kernels.add(a, total) == (a.sum(), (a.astype(np.int64) ** 2).sum())
    assert np.array_equal(total, a + np.uint32(1))
    squares, columns, rows = kernels.lines(total, 100)
    assert squares == ((total.astype(np.int64) - 100) ** 2).sum()
    assert np.array_equal(columns, total.sum(0)) and np.array_equal(rows, total.sum(1))


def test_a_stack_of_two_and_of_many_follow_the_same_formula():
    rng = np.random.default_rng(18)
    for count in (2, 5):
        data = rng.integers(90, 110, (count, 20, 30)).astype(np.uint16)
        found = levels.Levels(None)
        for i, frame in enumerate(data):
            found.add(Frame(data=frame, kind="flat", bit_depth=8, white_level_dn=255, exposure_s=1.0, file=str(i)), 5.0)
        found.close(255)
        (level,) = found.levels[""]
        means = data.mean(axis=(1, 2))
        expected = np.mean(data.astype(float).var(axis=0, ddof=1)) - means.var(ddof=1)
        assert level.variance_dn2 == pytest.approx(expected * 600 / 599)
        assert level.spatial_dn2 == pytest.approx(data.mean(axis=0).var())
        assert level.column_dn2 == pytest.approx(data.mean(axis=(0, 1)).var())


R4 = {"gain_dn_per_e": 0.27730174338199426, "responsivity_dn_per_photon": 0.12646116118581852, "saturation_photons": 30957.0,
      "quantum_efficiency_percent": 45.60417098121637, "dark_noise_dn": 3.081025915688292, "read_noise_e": 11.0618578646565,
      "absolute_threshold_photons": 25.48446439812677, "dynamic_range_db": 61.68966713265023,
      "saturation_e": 14117.683210655152, "snr_max": 118.81785728860436,
      "linearity_error_percent": 0.2977918191740729, "dark_current_e_per_s": 24.604737020356104,
      "dark_current_from_variance_e_per_s": 54.63748890588508, "dsnu_1288_e": 0.0, "dsnu_1288_row_e": 0.23880745205549825,
      "prnu_1288_percent": 0.24589893870485935, "prnu_1288_row_percent": 0.005565925674682588, "prnu_1288_column_percent": 0.0,
      "prnu_1288_pixel_percent": 0.24591793020282413, "dsnu_raw_e": 0.10593478052537923, "dsnu_raw_row_e": 0.26428578581561035,
      "dsnu_raw_column_e": 0.13327472156810627, "prnu_raw_percent": 0.2849767108030931}


def test_real_ccd_after_release_4(real):
    """Against figures computed after release 4 by others, and where the rules are the same by the reference code."""
    folder = real / "sensor" / "emva_ccd12_001"
    measured = transfer.measure(described_frames(read_descriptor(folder / "EMVA1288_Data.txt")))
    stated = json.loads((folder / "values_r4_rules.json").read_text())
    assert stated["R4 sat"]["K_free_offset"] == R4["gain_dn_per_e"]
    for name, value in R4.items():
        q = measured.quantity(name)
        assert abs(q.value - value) <= max(q.uncertainty, 1e-9), name
    reference = json.loads((folder / "values_emva1288_1.0.2.json").read_text())["got"]
    same = {"responsivity_dn_per_photon": "R", "dark_current_e_per_s": "u_I_mean", "prnu_raw_percent": "PRNU1288",
            "prnu_raw_row_percent": "PRNU1288_row", "prnu_raw_column_percent": "PRNU1288_col",
            "prnu_raw_pixel_percent": "PRNU1288_pixel", "dsnu_raw_e": "DSNU1288"}
    for mine, theirs in same.items():
        q = measured.quantity(mine)
        assert abs(q.value - reference[theirs]) <= q.uncertainty, mine


def test_map_stands_in_for_the_darks(light_ladder):
    shape = (64, 96)
    calmap = CalibrationMap(image_size_px=(96, 64), offset_dn=np.full(shape, 60.0), dark_rate_dn_per_s=np.full(shape, 5.0),
                            read_noise_dn=np.full(shape, math.sqrt(1 + 1 / 12)),
                            measured=frozenset({"offset_dn", "dark_rate_dn_per_s", "read_noise_dn"}))
    measured = transfer.measure(light_ladder(19, darks=False, stack=0), calmap=calmap)
    assert measured.quantity("gain_dn_per_e").value == pytest.approx(0.25, rel=0.02)
    with pytest.raises(BadInput, match="no darks"):
        transfer.measure(light_ladder(19, darks=False, stack=0))
