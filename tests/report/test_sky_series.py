"""The section of several sky frames: errors by kind, where the camera looked, mean residuals."""

from io import BytesIO

import matplotlib.image
import numpy as np
from scipy.spatial.transform import Rotation

from calibench.geometry import projection, rotation, sphere
from calibench.records import Attitude, CalibrationMap, Identification, Intrinsics, Spots
from calibench.report.sections import sky_series
from calibench.report.story import Story
from calibench.stars.solve import Solution

SIZE = (640, 480)
LENS = Intrinsics.pinhole(focal_px=900.0, image_size_px=SIZE, focal_sd_px=0.1)


def solution(rng, turn_deg, status="solved"):
    if status != "solved":
        return Solution(file="", spots=Spots.none(), identification=Identification(status=status, method="", reason="dew"),
                        attitude=Attitude.unsolved(status=status, method="quest", reason="dew"))
    matrix = Rotation.from_rotvec([0, np.radians(turn_deg), 0]).as_matrix()
    xy, rows = rng.uniform(10, np.subtract(SIZE, 10), (60, 2)), np.arange(60)
    found = Identification(status="solved", method="", spot_rows=rows, star_rows=rows, xy_px=xy, intrinsics=LENS,
                           covariance_px2=np.tile(np.eye(2) * 0.01, (60, 1, 1)),
                           direction_icrs=projection.unproject(LENS, xy) @ matrix)
    bend = 0.2 * (xy / SIZE - 0.5)
    attitude = Attitude(status="solved", method="quest", q_cam_icrs=rotation.quaternion_from_matrix(matrix),
                        covariance_rad2=np.eye(3) * 1e-10, residual_px=bend + rng.normal(0, 0.02, (60, 2)))
    ra, dec = sphere.radec_from_unit(matrix[2])
    return Solution(file="", spots=Spots.none(), identification=found, attitude=attitude, ra_rad=float(ra), dec_rad=float(dec),
                    roll_rad=0.0, fov_rad=0.68)


def story(*series):
    return Story(title="t", why="w", created="", software="", calmap=CalibrationMap(image_size_px=SIZE), series=series)


def test_a_series_is_told_in_two_figures_and_a_table():
    rng = np.random.default_rng(1)
    section = sky_series.render(story(*[solution(rng, turn) for turn in (0, 5, 10, 80)], solution(rng, 0, "no_match")))
    assert "4 of 5 frames solved" in section.paragraphs[0]
    rows = {row[0]: row for row in section.tables[0].rows}
    assert float(rows["FOV spatial"][1]) > 2 * float(rows["temporal noise"][1]) and rows["bias"][4].startswith("needs truth")
    where, mean = section.figures
    assert where.reading.startswith("240 matched stars in 4 frames") and "longest" in mean.reading
    for figure in section.figures:
        pixels = matplotlib.image.imread(BytesIO(figure.png))
        assert pixels.shape[0] > 300 and pixels.std() > 0.02


def test_one_frame_is_no_series():
    rng = np.random.default_rng(2)
    assert sky_series.render(story(solution(rng, 0), solution(rng, 0, "no_match"))) is None
    assert sky_series.render(story()) is None
