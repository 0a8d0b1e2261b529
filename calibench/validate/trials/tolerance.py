"""Tolerance: how large may a centroid's error be before a group of three stars is taken for another? After the thesis's study.

1. The groups: all triples of the sky's stars brighter than BRIGHTEST, doubles merged, no side longer than the frame's shorter
   side. Three stars have nothing beyond themselves to be verified against, so this is the hardest case of identification.
2. One star of a group, seen through the map's lens at the image's centre at a random roll, is moved by the error.
3. The identifiers look the three spots up among all groups, with tolerances from that error; of what they propose, the
   likeliest is the answer: for `pattern` by the three sides, for `area_polar_moment` by area and moment alone.
4. The ceiling is the answer of largest likelihood among all groups, asked without any tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from ...errors import BadInput
from ...geometry import projection, rotation
from ...records import CalibrationMap, Observer, Spots
from ...stars.camera_table import camera_table
from ...stars.code_table import CodeTable
from ...stars.identify import _triangles, area_polar_moment
from ...stars.lost_in_space import LostInSpace
from ...stars.sky_catalogue import SkyCatalogue
from ...stars.view import KnownLens, View
from ..case import SkyCase, Trial, the_lens

BRIGHTEST = 4.0
MERGED_PX = 3.0  # doubles closer than this make one spot
ERRORS_PERCENT = (0.04, 0.08, 1.0, 10.0)  # of a pixel; the first two are the thesis's
GROUPS = 1000  # drawn of all for each error
STEP = 1e-7  # rad, of the numerical derivatives
COLUMNS = ("error_percent_px", "groups", "tried", "pattern_percent", "area_polar_moment_percent", "area_moment_ceiling_percent")


def variants(calmap: CalibrationMap) -> dict[str, float]:
    """The errors that are tried, px."""
    return {f"{percent:g} % of a pixel": percent / 100 for percent in ERRORS_PERCENT}


def groups_of(sky: SkyCatalogue, longest_rad: float) -> np.ndarray:
    """(G, 3) rows of all triples without a side longer than longest_rad."""
    near = cKDTree(sky.directions).query_pairs(2 * np.sin(longest_rad / 2), output_type="ndarray")
    beside = [set() for _ in sky.directions]
    for i, j in near:
        beside[min(i, j)].add(max(i, j))
    return np.array([(i, j, k) for i, js in enumerate(beside) for j in js for k in js & beside[j]]).reshape(-1, 3)


def trial(cases: Sequence[SkyCase], calmap: CalibrationMap, finders: Callable[[SkyCase], LostInSpace],
          settings: dict | None = None, tick: Callable[[], None] = lambda: None) -> tuple[Trial, dict]:
    """The table of errors. cases: their first frame says whose sky is taken.

    Raises:
        BadInput: the map has no lens, or its field holds too few groups.
    """
    lens = KnownLens(the_lens(calmap, "the tolerance study"))
    width, height = calmap.image_size_px
    table = finders(cases[0]).sky.table
    seen = camera_table(table, faintest_hp=BRIGHTEST, part_rad=MERGED_PX / calmap.intrinsics.fx_px).table
    sky = SkyCatalogue.seen_by(seen, Observer())
    groups = groups_of(sky, 2 * np.arctan(min(width, height) / 2 / calmap.intrinsics.fy_px))
    if len(groups) < 100:
        raise BadInput(f"the field holds only {len(groups)} groups of stars brighter than {BRIGHTEST:g}",
                       mend="the study is for wide fields")
    rng, rows = np.random.default_rng(0), []
    sides, moments = _side_table(sky, groups, lens), _moment_table(sky, groups)
    for percent, error_px in zip(ERRORS_PERCENT, variants(calmap).values(), strict=True):
        right = np.zeros(3)
        drawn = groups[rng.choice(len(groups), min(GROUPS, len(groups)), replace=False)]
        for group in drawn:
            view = _seen(sky, group, lens, error_px, rng)
            right += [_is(group, _by_sides(view, sky, sides)), _is(group, _by_moment(view, sky, moments)),
                      _is(group, _ceiling(view, moments))]
        rows.append((percent, len(groups), len(drawn), *(100 * right / len(drawn)).tolist()))
        tick()
    reading = ("part of three-star groups, one star off by the error, that are taken for themselves; the ceiling is what area "
               "and polar moment allow at best")
    return Trial(name="tolerance", columns=COLUMNS, rows=tuple(rows), reading=reading), {}


def _seen(sky: SkyCatalogue, group: np.ndarray, lens: KnownLens, error_px: float, rng: np.random.Generator) -> View:
    """The group at the image's centre at a random roll, one star moved by error_px."""
    stars, field = sky.directions[group], lens.view(Spots.none()).field
    middle = stars.mean(0) / np.linalg.norm(stars.mean(0))
    axis = np.cross(middle, field.centre)
    turn = np.arctan2(np.linalg.norm(axis), middle @ field.centre)
    to_centre = rotation.matrix_from_rotvec(axis / max(np.linalg.norm(axis), 1e-12) * turn)
    roll = rotation.matrix_from_rotvec(field.centre * rng.uniform(0, 2 * np.pi))
    xy = projection.project(lens.intrinsics, stars @ (roll @ to_centre).T)
    direction = rng.uniform(0, 2 * np.pi)
    xy[rng.integers(3)] += error_px * np.array([np.cos(direction), np.sin(direction)])
    nothing = np.zeros(3)
    return lens.view(Spots(xy_px=xy, covariance_px2=np.tile(np.eye(2) * error_px**2 / 2, (3, 1, 1)), flux_e=nothing,
                           background_dn=nothing, peak_dn=nothing, pixels=nothing, flags=nothing))


def _is(group: np.ndarray, answer: np.ndarray | None) -> bool:
    return answer is not None and set(answer.tolist()) == set(group.tolist())


def _side_table(sky: SkyCatalogue, groups: np.ndarray, lens: KnownLens) -> CodeTable:
    return _triangles.table_of(sky, groups, lens.view(Spots.none()).field.half_diagonal)


def _moment_table(sky: SkyCatalogue, groups: np.ndarray) -> area_polar_moment.Table:
    return area_polar_moment.table_of(sky, groups)


def _by_sides(view: View, sky: SkyCatalogue, table: CodeTable) -> np.ndarray | None:
    """The proposal whose sides fit best, and whose corners turn the right way."""
    spots, stars = (np.concatenate(part) for part in zip(*_triangles.propose(view, sky, table), strict=True))
    camera, star = view.directions[spots], sky.directions[stars]
    same_hand = np.linalg.det(camera) * np.linalg.det(star) > 0
    if not same_hand.any():
        return None
    misfit = ((_triangles.sides(camera) - _triangles.sides(star)) ** 2).sum(1)
    return stars[np.where(same_hand, misfit, np.inf).argmin()]


def _likeliest(view: View, table: area_polar_moment.Table, rows: np.ndarray) -> np.ndarray | None:
    """Of these rows of the table, the one whose area and moment fit best, by the covariance that the corners' errors give."""
    if not len(rows):
        return None
    side = area_polar_moment.triangle_sides(view.directions)
    area, moment = area_polar_moment.area_and_moment(side)
    covariance = np.zeros((2, 2))  # a corner moves two sides together, so it is propagated from the corners
    for corner in range(3):
        for axis in np.eye(3):
            moved = view.directions.copy()
            moved[corner] += STEP * axis
            there = area_polar_moment.area_and_moment(area_polar_moment.triangle_sides(moved))
            slope = (np.array(there) - (area, moment)) / STEP
            covariance += np.outer(slope, slope) * view.sigma_rad[corner] ** 2
    off = np.stack([table.area[rows] - area, table.moment[rows] - moment], -1)
    return table.rows[rows[np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off).argmin()]]


def _by_moment(view: View, sky: SkyCatalogue, table: area_polar_moment.Table) -> np.ndarray | None:
    return _likeliest(view, table, area_polar_moment.within(view, np.arange(3), table))


def _ceiling(view: View, table: area_polar_moment.Table) -> np.ndarray | None:
    return _likeliest(view, table, np.arange(len(table.area)))
