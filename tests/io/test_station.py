"""Where a camera stands or flies: what a person writes, and how mistakes are answered."""

from pathlib import Path

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.io.frame_writer import write_frame
from calibench.io.frames import read_frame
from calibench.io.observer import frame_observer, observer_at
from calibench.io.station import read_station
from calibench.records import Station


def written(folder: Path, text: str):
    path = folder / "a.fits"
    write_frame(path, np.zeros((48, 64), np.uint16), kind="light", exposure_s=0.2, bit_depth=10,
                date_obs="2024-05-17T21:04:05")
    (folder / "a.fits.toml").write_text(text)
    return read_frame(path, "light")


def test_a_sidecar_gives_the_station_and_the_frame_its_instant(tmp_path):
    frame = written(tmp_path, "[station]\nlatitude_deg = 48.2\nlongitude_deg = 16.4\nrefraction = 'erfa'\nrow_time_s = 1e-3\n")
    assert frame.station.latitude_rad == pytest.approx(np.radians(48.2))
    observer = frame_observer(frame)
    assert observer.time_utc == "2024-05-17T21:04:05.123500"  # half the exposure, and 23.5 rows
    assert observer.refraction.model == "erfa" and not observer.rolling.rate_rad_s.any()  # no rate is known
    other = frame_observer(frame, Station(velocity_km_s=(0, 0, 7.0)))
    assert other.refraction is None
    added_c = other.velocity_c - observer_at(observer.time_utc).velocity_c
    np.testing.assert_allclose(added_c * 299792.458, [0, 0, 7], atol=1e-4)


def test_written_out_and_from_a_file(tmp_path):
    text = "velocity_km_s = [1.0, -2, 3]; rate_deg_s = [0, 0, 1.0]; row_time_s = 2e-5; readout = 'up'"
    station = read_station(text)
    assert station.velocity_km_s == (1.0, -2.0, 3.0) and station.rate_rad_s[2] == pytest.approx(np.radians(1))
    file = tmp_path / "s.toml"
    file.write_text("[station]\n" + text.replace(";", "\n"))
    assert read_station(str(file)) == station


@pytest.mark.parametrize(("text", "complaint"), [
    ("latitude_deg = 91; longitude_deg = 0", "outside"), ("latitude_deg = 10", "latitude and longitude"),
    ("refraction = 'erfa'", "needs the place"), ("speed = 3", "unknown key speed"), ("humidity = 50", "humidity 50"),
    ("velocity_km_s = [1, 2]", "three numbers"), ("velocity_km_s = [1e9, 0, 0]", "length 50 or less"),
    ("latitude_deg = 1; longitude_deg = 1; refraction = 'none'", "erfa, bennett"), ("readout = 'left'", "down, up"),
    ("latitude_deg = nan; longitude_deg = 0", "finite number"), ("height_m = 'high'", "finite number"),
    ("latitude_deg = 1; longitude_deg = 1; velocity_km_s = [1, 2, 3]", "one of the two"), ("x = [", "station"),
    ("no/such/file.toml", "no readable file")])
def test_mistakes_are_answered(text, complaint):
    with pytest.raises(BadInput, match=complaint):
        read_station(text)


def test_a_place_without_a_date_is_refused():
    with pytest.raises(BadInput, match="no date"):
        observer_at(None, Station(latitude_rad=0.1, longitude_rad=0.2))


def test_a_wrong_station_names_its_sidecar(tmp_path):
    with pytest.raises(BadInput, match="a.fits.toml.*\n.*station: humidity 50"):
        written(tmp_path, "[station]\nhumidity = 50\n")
