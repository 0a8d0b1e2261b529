"""The difference of two maps: a rotation is no difference, what is left is, and its size is what the covariances say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibench.calmap.compare import compare
from calibench.calmap.compare_lens import lens_difference
from calibench.errors import BadInput
from calibench.geometry import projection, rotation
from calibench.records import DEFECT_FLAGS, CalibrationMap, Intrinsics

SIZE = (1280, 960)
TRUTH = np.array([1500.0, 1502.0, 640.0, 478.0, -0.1, 0.05, 1e-4, 2e-4])
ARCSEC = np.radians(1 / 3600)


def lens(parameters=TRUTH, covariance=None, **changes) -> Intrinsics:
    return Intrinsics(**{"model": "brown4", "fx_px": parameters[0], "fy_px": parameters[1], "cx_px": parameters[2],
                         "cy_px": parameters[3], "distortion": parameters[4:], "image_size_px": SIZE,
                         "covariance": np.eye(8) if covariance is None else covariance} | changes)


def test_a_lens_does_not_differ_from_itself():
    found = lens_difference(lens(), lens(model="brown5", distortion=[*TRUTH[4:], 0.0], covariance=np.eye(9)))
    assert found.rms_px < 1e-9 and found.rms_rad < 1e-12 and np.abs(found.rotation_rad).max() < 1e-12
    corners = {(0.0, 0.0), (1279.0, 0.0), (0.0, 959.0), (1279.0, 959.0)}
    assert corners <= set(map(tuple, found.xy_px.tolist()))


def test_a_moved_principal_point_is_nearly_a_rotation_and_the_rest_is_left():
    """A turn by d/f moves the picture by d (1 + x^2/f^2): of 3 px, the second-order part stays as a difference."""
    moved = lens(TRUTH + [0, 0, 3, 0, 0, 0, 0, 0])
    found = lens_difference(lens(), moved)
    assert 0.05 < found.rms_px < 0.5
    assert found.rotation_rad[1] == pytest.approx(-3 / 1500, rel=0.15) and abs(found.rotation_rad[0]) < 1e-5
    raw = projection.project(moved, projection.unproject(lens(), found.xy_px)) - found.xy_px
    assert np.sqrt(np.mean(np.sum(raw**2, axis=1))) == pytest.approx(3, rel=0.01)


def test_the_rotation_is_the_best_one():
    a, b = lens(), lens(TRUTH + [2, 1, 3, -2, 0.003, 0, 1e-4, 0])
    found = lens_difference(a, b)
    v = projection.unproject(a, found.xy_px)

    def rms_px(turn_rad):
        turn = rotation.matrix_from_rotvec(np.asarray(turn_rad))
        return np.sqrt(np.mean(np.sum((projection.project(b, v @ turn.T) - found.xy_px) ** 2, axis=1)))

    assert rms_px(found.rotation_rad) == pytest.approx(found.rms_px, abs=1e-12)
    for step in np.vstack([np.eye(3), -np.eye(3)]) * 5 * ARCSEC:
        assert rms_px(found.rotation_rad + step) > found.rms_px


def test_the_other_way_round_it_is_the_same_difference():
    a, b = lens(), lens(TRUTH + [2, 1, 3, -2, 0.003, 0, 1e-4, 0])
    there, back = lens_difference(a, b), lens_difference(b, a)
    assert there.rms_px == pytest.approx(back.rms_px, rel=1e-2) and there.rms_rad == pytest.approx(back.rms_rad, rel=1e-2)
    np.testing.assert_allclose(there.rotation_rad, -back.rotation_rad, atol=0.5 * ARCSEC)


def test_a_longer_focal_length_by_hand():
    """Pinholes of 1000 and 1001 px: a shift of r/1000, the angle of which is r / 1000 / f / (1 + r^2/f^2)."""
    a, b = (Intrinsics.pinhole(focal_px=f, image_size_px=SIZE) for f in (1000.0, 1001.0))
    found = lens_difference(a, b)
    offset = found.xy_px - (np.array(SIZE) - 1) / 2
    np.testing.assert_allclose(found.shift_px, offset / 1000, atol=1e-9)
    r = np.hypot(*offset.T)
    np.testing.assert_allclose(found.angle_rad, np.arctan(r / 1000) - np.arctan(r / 1001), atol=1e-12)
    assert np.isinf(found.expected_rms_px)


def test_a_rotation_of_the_centre_leaves_the_centre_closer():
    a, b = lens(), lens(TRUTH + [2, 1, 3, -2, 0.003, 0, 1e-4, 0])
    whole, central = lens_difference(a, b), lens_difference(a, b, fit_radius_px=250)
    assert central.inside.sum() < whole.inside.sum() == len(whole.xy_px)

    def rms_px(difference):
        return np.sqrt(np.mean(np.sum(difference.shift_px[central.inside] ** 2, axis=1)))

    assert rms_px(central) < rms_px(whole) and central.rms_px > whole.rms_px


@pytest.mark.parametrize("fit_radius_px", [None, 300.0])
def test_the_difference_is_as_large_as_the_covariances_say(fit_radius_px):
    rng = np.random.default_rng(1)
    root = rng.normal(size=(8, 8)) / 3
    sd = np.array([0.5, 0.5, 1, 1, 1e-3, 3e-3, 1e-4, 1e-4])
    covariance = root @ root.T * np.outer(sd, sd)
    ratio = []
    for _ in range(150):
        a, b = (lens(TRUTH + rng.multivariate_normal(np.zeros(8), covariance), covariance) for _ in range(2))
        found = lens_difference(a, b, fit_radius_px)
        ratio.append(np.sum(found.shift_px**2, axis=1) / found.expected_px**2)
    ratio = np.mean(ratio, axis=0)  # of chi-square over its expectation, a value a place
    assert np.mean(ratio) == pytest.approx(1, abs=0.2)
    corners = np.ravel_multi_index(([0, 0, -1, -1], [0, -1, 0, -1]), (22, 30), mode="wrap")
    assert np.mean(ratio[corners]) == pytest.approx(1, abs=0.25)


@pytest.mark.parametrize(("change", "complaint"), [
    ({"image_size_px": (640, 480)}, "1280 x 960 and 640 x 480"), ({"mirrored": True}, "mirrored"),
    ({"distortion": [-2.0, 0.0, 0.0, 0.0]}, "cannot be inverted|folds"),
    ({"cx_px": 30000.0}, "no rotation|cannot be inverted"),
])
def test_what_cannot_be_compared_is_said(change, complaint):
    with pytest.raises(BadInput, match=complaint) as caught:
        lens_difference(lens(), lens(**change))
    assert caught.value.mend


def test_a_region_without_pixels_is_refused():
    with pytest.raises(BadInput, match="too small"):
        lens_difference(lens(), lens(), fit_radius_px=1.0)


W, H = 40, 30


def camera_map(**layers) -> CalibrationMap:
    return CalibrationMap(image_size_px=(W, H), measured=frozenset(layers), **layers)


def test_layers_change_by_median_scatter_and_largest():
    rng = np.random.default_rng(2)
    offset = rng.normal(64, 5, (H, W))
    change = 3 + rng.normal(0, 0.5, (H, W))
    change[4, 5], change[6, 7] = 20, 9000
    defects = np.zeros((H, W), np.uint16)
    defects[6, 7] = DEFECT_FLAGS["hot"]
    found = compare(camera_map(offset_dn=offset, gain_dn_per_e=0.5),
                    camera_map(offset_dn=offset + change, gain_dn_per_e=0.6, defects=defects, response=np.ones((H, W))))
    by_name = {layer.name: layer for layer in found.layers}
    assert by_name["offset_dn"].median == pytest.approx(3, abs=0.05)
    assert by_name["offset_dn"].scatter == pytest.approx(0.5, rel=0.1)
    assert by_name["offset_dn"].largest == pytest.approx(20, abs=1e-4)  # the defective pixel does not count
    assert by_name["gain_dn_per_e"].median == pytest.approx(0.1)
    assert found.lens is None and found.defects == ()
    assert found.only_in_a == () and found.only_in_b == ("response", "defects")


def test_defects_appear_and_go():
    a, b = np.zeros((2, H, W), np.uint16)
    a[0, :3], b[0, 2:7] = DEFECT_FLAGS["hot"], DEFECT_FLAGS["hot"] | DEFECT_FLAGS["cluster"]
    found = {change.name: dataclasses.astuple(change)[1:6] for change in
             compare(camera_map(defects=a), camera_map(defects=b)).defects}
    assert found == {"hot": (3, 5, 1, 4, 2), "cluster": (0, 5, 0, 5, 0)}


def test_where_all_pixels_are_defective_they_are_compared_all_the_same():
    defects = np.full((H, W), DEFECT_FLAGS["warm"], np.uint16)
    found = compare(camera_map(offset_dn=np.zeros((H, W)), defects=defects),
                    camera_map(offset_dn=np.ones((H, W)), defects=defects))
    assert [(layer.name, layer.median, layer.scatter) for layer in found.layers] == [("offset_dn", 1.0, 0.0)]


def test_maps_of_two_sizes_are_refused():
    with pytest.raises(BadInput, match="40 x 30 and 41 x 30"):
        compare(camera_map(), CalibrationMap(image_size_px=(41, 30)))


def test_growth_is_told_from_pixels_at_the_threshold():
    rng = np.random.default_rng(3)
    hot = DEFECT_FLAGS["hot"]
    error = np.full((H, W), 1.0)
    rate = rng.normal(10, 1, (H, W))
    before, after = np.zeros((H, W), np.uint16), np.zeros((H, W), np.uint16)
    later = rate + rng.normal(0, 1, (H, W))
    grown, gone = [(0, i) for i in range(12)], [(1, i) for i in range(4)]
    for i, place in enumerate(grown):
        after[place] = hot
        later[place] += 100 if i < 9 else 0  # three of them crossed the threshold by chance
    for place in gone:
        before[place] = hot
    maps = [camera_map(dark_rate_dn_per_s=r, dark_rate_uncertainty_dn_per_s=error, defects=d)
            for r, d in ((rate, before), (later, after))]
    change = next(d for d in compare(*maps).defects if d.name == "hot")
    assert (change.new, change.gone, change.new_certain, change.gone_certain) == (12, 4, 9, 0)
    assert change.confirmed == 0 and change.growth_sigma == pytest.approx(3.0)  # of the nine that have surely changed
    back = next(d for d in compare(*maps[::-1]).defects if d.name == "hot")
    assert (back.gone_certain, back.growth_sigma) == (9, pytest.approx(-3.0))
    without = [camera_map(defects=d) for d in (before, after)]
    assert next(iter(compare(*without).defects)).new_certain is None


@pytest.mark.parametrize(("energy_ev", "certain"), [(0.6, (0, 1)), (None, (None, None))])
def test_a_warmer_session_has_no_new_hot_pixels_for_that(energy_ev, certain):
    """15 degrees warmer the rates are 3.3-fold: pixels cross the limit, none has changed but the one that healed."""
    hot = DEFECT_FLAGS["hot"]
    cold, warm = 10.0, 25.0
    factor = np.exp(-0.6 / 8.617333e-5 * (1 / (warm + 273.15) - 1 / (cold + 273.15)))
    rate = np.random.default_rng(4).normal(10, 0.1, (H, W))
    rate[2, :10] = 18
    later = factor * rate
    before = np.where(rate > 20, hot, 0).astype(np.uint16)
    before[5, 5], rate[5, 5] = hot, 90
    after = np.where(later > 20 * 1.9, hot, 0).astype(np.uint16)
    law = {} if energy_ev is None else {"dark_activation_ev": energy_ev}
    error = np.full((H, W), 0.5)
    a, b = (camera_map(dark_rate_dn_per_s=r, dark_rate_uncertainty_dn_per_s=error, defects=d, dark_reference_c=c, **extra)
            for r, d, c, extra in ((rate, before, cold, law), (later, after, warm, {})))
    change = next(d for d in compare(a, b).defects if d.name == "hot")
    assert (change.new, change.gone) == (10, 1)
    assert (change.new_certain, change.gone_certain) == certain
