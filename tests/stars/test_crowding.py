"""Stars whose neighbours pull their spots are believed less, by as much as the pull."""

import numpy as np
import pytest

from calibench.io.star_table import load_star_table
from calibench.records import Identification, Intrinsics, Observer
from calibench.stars.crowding import FADE, STEP, UNKNOWN_SIGMA_PX, pull2_rad2, with_crowding
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue

FOCAL_PX = 1400.0


def test_the_pull_follows_from_separation_and_light():
    sky = SkyCatalogue.seen_by(load_star_table(), Observer())
    sky = SkyCatalogue.seen_by(sky.table.take(sky.magnitude < 6.5), Observer())
    sigma = 0.9 / FOCAL_PX
    pull2 = pull2_rad2(sky, sigma)
    gram = np.clip(sky.directions @ sky.directions.T, -1, 1)
    np.fill_diagonal(gram, -1)
    apart = np.arccos(gram)
    alone = apart.min(1) > 1.6 * FADE * sigma
    assert 0.8 < alone.mean() < 0.99 and (pull2[alone] == 0).all() and (pull2[~alone] > 0).all()
    mates = np.argmin(apart, 1)
    close = (apart.min(1) < 1.2 * sigma) & ((apart < 2 * FADE * sigma).sum(1) == 1)
    light = 10 ** (-0.4 * sky.magnitude)
    part = light[mates] / (light + light[mates])
    assert close.sum() > 10
    np.testing.assert_allclose(np.sqrt(pull2[close]), (part * apart.min(1))[close], rtol=0.03)


@pytest.mark.parametrize("focal_px", [FOCAL_PX, 300.0])
def test_the_spots_covariance_grows_by_it(focal_px):
    sky = SkyCatalogue.seen_by(load_star_table(), Observer())
    rows = np.arange(500)
    lens = Intrinsics.pinhole(focal_px=focal_px, image_size_px=(752, 480))
    found = Identification(status="solved", method="", spot_rows=rows, star_rows=rows, xy_px=np.zeros((500, 2)),
                           covariance_px2=np.tile(np.eye(2) * 0.01, (500, 1, 1)), direction_icrs=sky.directions[:500],
                           intrinsics=lens)
    finder = LostInSpace(sky=sky)
    more = with_crowding(found, finder, None) - found.covariance_px2
    step = round(np.log(UNKNOWN_SIGMA_PX / focal_px) / STEP)
    np.testing.assert_allclose(more[:, 0, 0], pull2_rad2(sky, np.exp(step * STEP))[:500] * focal_px**2, rtol=1e-9, atol=1e-12)
    assert (more[:, 0, 1] == 0).all() and (more[:, 0, 0] == more[:, 1, 1]).all() and 0 < (more[:, 0, 0] > 0).mean() < 1
    assert len(finder.tables) == 1
