"""A series through the session: found lost in space, then tracked; a jump goes back to lost in space, and the CSV tells it."""

import csv

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import erf

from calibench.geometry import projection
from calibench.io.csv_table import write_csv
from calibench.io.star_table import load_star_table
from calibench.records import CalibrationMap, Frame, Intrinsics, Observer
from calibench.session.results import CSV_COLUMNS, solved_json
from calibench.session.sky import Sky
from calibench.session.track import Track
from calibench.stars.sky_catalogue import SkyCatalogue

SIZE = (752, 480)
LENS = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=379.0, cy_px=236.0, distortion=[-0.37, 0.31, -1e-3, 3e-4],
                  image_size_px=SIZE, covariance=np.diag([.04, .04, .01, .01, 1e-8, 1e-8, 1e-12, 1e-12]))
MAP = CalibrationMap(image_size_px=SIZE, measured=frozenset({"intrinsics"}), intrinsics=LENS)


def seen(sky, matrix, rng, name):
    xy = projection.project(LENS, sky.directions @ matrix.T)
    on = ((xy > 8) & (xy < np.subtract(SIZE, 9))).all(1)
    light = np.full(SIZE[::-1], 5.0)
    for (x, y), magnitude in zip(xy[on], sky.magnitude[on], strict=True):
        i, j = round(x) + np.arange(-6, 7), round(y) + np.arange(-6, 7)
        along, down = (0.5 * (erf((k + 0.5 - at) / 1.27) - erf((k - 0.5 - at) / 1.27)) for k, at in ((i, x), (j, y)))
        light[np.ix_(j, i)] += 1e5 * 10 ** (-0.4 * magnitude) * np.outer(down, along)
    data = np.clip(np.round(rng.poisson(light * 10) / 10 + 64 + rng.normal(0, 1, light.shape)), 0, 4095)
    return Frame(data=data.astype(np.uint16), kind="light", bit_depth=12, white_level_dn=4095.0, exposure_s=0.1, file=name)


def test_a_series_is_tracked_and_a_jump_found_again(tmp_path):
    rng, table = np.random.default_rng(71), load_star_table()
    table = table.take(table.hp_mag <= 6.0)
    stars = SkyCatalogue.seen_by(table, Observer())
    truth = Rotation.random(random_state=72).as_matrix()
    step = Rotation.from_rotvec([2e-4, -1e-4, 3e-4]).as_matrix()
    attitudes = [truth := step @ truth for _ in range(5)]
    other = Rotation.random(random_state=73).as_matrix()
    attitudes += [other, step @ other, step @ step @ other]
    track, out = Track(Sky(table=table)), []
    for k, truth in enumerate(attitudes):
        solved = track.solve(seen(stars, truth, rng, f"{k}.fits"), MAP)
        assert solved.solution.status == "solved"
        matrix = Rotation.from_quat(solved.solution.attitude.q_cam_icrs).as_matrix()
        assert Rotation.from_matrix(matrix @ truth.T).magnitude() * 206265 < 30
        out.append(solved_json(solved, MAP, (table.hip, table.hp_mag)))
    assert [one["identified_by"] for one in out] == ["pattern", *["tracking"] * 4, "pattern", "tracking", "tracking"]
    assert all(one["sigma_systematic_cross_arcsec"] > 0 and one["stars"] for one in out)
    write_csv(tmp_path / "s.csv", out, CSV_COLUMNS)
    with open(tmp_path / "s.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(attitudes) and float(rows[3]["ra_deg"]) == out[3]["ra_deg"]
    assert rows[3]["time_utc"] == "" and len(rows[3]["q_cam_icrs"].split()) == 4
