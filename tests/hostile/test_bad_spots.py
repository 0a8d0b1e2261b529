"""Frames that are no sky: every detector and centroider answers with no spots or flagged ones, never with a crash."""

import numpy as np
import pytest

from calibench import registry
from calibench.errors import BadInput
from calibench.records import SPOT_FLAGS, CalibrationMap, CorrectedFrame, Frame, PsfMap
from calibench.spots.find import find_spots
from calibench.stars.find_stars import FindState, find_stars


def bad_frames():
    rng = np.random.default_rng(1)
    noise = rng.normal(100, 5, (90, 130))
    hot, nan, white = noise.copy(), noise.copy(), noise.copy()
    hot[rng.random(hot.shape) < 0.002] += 2000
    nan[20:60, 30:90] = np.nan
    white[:, 40:] = 4095
    return {"zero": np.zeros((90, 130)), "constant": np.full((90, 130), 77.0), "hot": hot, "nan": nan,
            "all_nan": np.full((90, 130), np.nan), "half_white": white, "white": np.full((90, 130), 4095.0),
            "one_row": noise[:1], "one_column": noise[:, :1], "one_pixel": noise[:1, :1], "two_rows": noise[:2],
            "stripes": np.where(np.arange(130) % 2, 500.0, 100.0) * np.ones((90, 1)), "infinite": np.full((90, 130), np.inf)}


@pytest.mark.parametrize("name", bad_frames())
@pytest.mark.parametrize("detector", registry.names("calibench.spots.detect"))
def test_no_detector_stumbles(name, detector):
    data = bad_frames()[name].astype(np.float32)
    frame = CorrectedFrame(signal_dn=data, variance_dn2=np.full(data.shape, np.nan, np.float32),
                           defects=np.zeros(data.shape, np.uint16), gain_dn_per_e=np.nan)
    spots = find_spots(frame, PsfMap.unknown(data.shape[::-1]), detector=detector)
    assert np.isfinite(spots.xy_px).all() and np.isfinite(spots.covariance_px2).all()
    if detector == "scan":
        assert len(spots) <= 3 if name != "stripes" else len(spots) < 200


@pytest.mark.parametrize("centroider", registry.names("calibench.spots.centroid"))
@pytest.mark.parametrize("name", ["hot", "nan", "half_white", "stripes", "two_rows"])
def test_no_centroider_stumbles(name, centroider):
    data = bad_frames()[name].astype(np.float32)
    frame = CorrectedFrame(signal_dn=data, variance_dn2=np.full(data.shape, 25, np.float32),
                           defects=np.zeros(data.shape, np.uint16), gain_dn_per_e=0.5)
    spots = find_spots(frame, PsfMap.unknown(data.shape[::-1]), centroider=centroider, false_alarms=5.0)
    assert np.isfinite(spots.xy_px).all() and np.isfinite(spots.covariance_px2).all()


@pytest.mark.parametrize("name", bad_frames())
def test_the_fast_path_does_not_stumble(name):
    data = bad_frames()[name]
    dtype = np.uint16 if np.isfinite(data).all() else np.float32
    frame = Frame(data=data.astype(dtype), bit_depth=12, white_level_dn=4095.0, exposure_s=0.1)
    calmap, state = CalibrationMap(image_size_px=frame.image_size_px), FindState()
    for _ in range(2):
        spots = find_stars(frame, calmap, state)
        assert np.isfinite(spots.xy_px).all() and np.isfinite(spots.covariance_px2).all()


def test_a_frame_of_another_size_than_the_map_is_refused():
    frame = Frame(data=np.zeros((20, 30), np.uint16), bit_depth=12, white_level_dn=4095.0)
    with pytest.raises(BadInput, match="31 x 20"):
        find_stars(frame, CalibrationMap(image_size_px=(31, 20)), FindState())


def test_a_saturated_spot_is_flagged_and_its_error_bar_holds_it():
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:80, :80]
    for _ in range(5):
        cx, cy = rng.uniform(38, 42, 2)
        light = rng.poisson(60000 * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 2 / 1.2**2) + 100)
        frame = Frame(data=np.minimum(light, 4095).astype(np.uint16), bit_depth=12, white_level_dn=4095.0)
        spots = find_stars(frame, CalibrationMap(image_size_px=(80, 80)), FindState(false_alarms=0.01))
        row = np.linalg.norm(spots.xy_px - (cx, cy), axis=1).argmin()
        error = spots.xy_px[row] - (cx, cy)
        assert spots.flags[row] & SPOT_FLAGS["saturated"]
        assert error @ np.linalg.inv(spots.covariance_px2[row]) @ error < 14
