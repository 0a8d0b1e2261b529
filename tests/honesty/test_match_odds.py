"""The stated false-match probability against the observed rate, where there is nothing to find."""

import numpy as np
import pytest

from calibench.io.star_table import load_star_table
from calibench.records import Intrinsics, Observer, Spots
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue

SIZE = (752, 480)


@pytest.fixture(scope="module")
def finder() -> LostInSpace:
    return LostInSpace(sky=SkyCatalogue.seen_by(load_star_table(), Observer()))


def spots_at(xy: np.ndarray, sigma_px: float) -> Spots:
    nothing = np.zeros(len(xy))
    return Spots(xy_px=xy, covariance_px2=np.tile(np.eye(2) * sigma_px**2, (len(xy), 1, 1)), flux_e=nothing,
                 background_dn=nothing, peak_dn=nothing, pixels=nothing, flags=nothing)


def scattered(rng) -> np.ndarray:
    return rng.uniform(-0.5, np.subtract(SIZE, 0.5), (int(rng.integers(5, 31)), 2))


def in_flocks(rng) -> np.ndarray:
    """Two tight groups and a line, as of a tree's edge: chance agreements come in flocks, too."""
    groups = [rng.normal(rng.uniform((100, 100), (650, 380)), 25, (8, 2)) for _ in range(2)]
    along = rng.uniform(0, 752, 10)
    return np.concatenate([*groups, np.stack([along, 400 + 0.05 * along + rng.normal(0, 3, 10)], -1)])


@pytest.mark.parametrize("spots", [scattered, in_flocks])
@pytest.mark.parametrize(("lens_known", "count", "sigma_px"), [(True, 150, 0.2), (True, 30, 1.0), (False, 40, 0.2)])
def test_stated_odds_are_not_beaten(finder, spots, lens_known, count, sigma_px):
    rng, stated = np.random.default_rng(40), []
    lens = Intrinsics.pinhole(focal_px=1565.0, image_size_px=SIZE, focal_sd_px=0.5) if lens_known else None
    for _ in range(count):
        found = finder.identify(spots_at(spots(rng), sigma_px), SIZE, lens=lens, fov_rad=None if lens else np.radians(27))
        assert found.status != "solved" and found.reason
        stated.append(found.false_match_probability)
    for x in (0.3, 0.1, 0.03, 0.01, 1e-3):
        assert np.mean(np.array(stated) <= x) <= x + 3 * np.sqrt(x / count), (x, sorted(stated)[:5])
