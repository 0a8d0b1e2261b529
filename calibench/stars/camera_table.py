"""The star table as one camera sees it: down to its limit, with stars that its PSF does not part merged into one.

A pair closer than the PSF's width is one spot at the flux-weighted place, with the summed light. A table that keeps both
predicts two stars where there is one, and each a part of the separation off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..errors import BadInput
from ..geometry import sphere
from ..records import StarTable
from .circles import fibonacci_sphere

VIEWS = 20_000
FEWEST_STARS = 4  # that an identification needs


@dataclass(frozen=True, kw_only=True)
class Merged:
    """One spot of several stars: hip (K,), brightest first, and how far (rad) the spot lies from the brightest."""

    hip: tuple[int, ...]
    shift_rad: float
    hp_mag: float


@dataclass(frozen=True, kw_only=True)
class CameraTable:
    """table: brightest first. merged: what was made one. stars_in_view: (VIEWS,) stars within the field, boresights spread
    evenly over the sky; empty where no field was given."""

    table: StarTable
    merged: tuple[Merged, ...]
    stars_in_view: np.ndarray

    @property
    def poor_views(self) -> float:
        """Share of all boresights with fewer than FEWEST_STARS stars in the field."""
        return float(np.mean(self.stars_in_view < FEWEST_STARS)) if len(self.stars_in_view) else float("nan")


def camera_table(table: StarTable, *, faintest_hp: float, part_rad: float, field_rad: float | None = None) -> CameraTable:
    """The table down to a limit (Hp), stars within part_rad of a brighter one merged with it.

    Stars up to 2.5 magnitudes fainter than the limit still pull a merged spot, so merging comes before the cut. field_rad:
    horizontal field, for counting the stars of round views of half its width.

    Raises:
        BadInput: the limit leaves no stars, or lies beyond the table's own.
    """
    deepest = float(table.hp_mag.max())
    if faintest_hp > deepest + 0.05:
        raise BadInput(f"the star table ends at Hp {deepest:.1f}; a limit of {faintest_hp:g} would promise stars that it lacks",
                       mend=f"give a limit up to {deepest:.1f}, or build a deeper table first")
    table = table.take(np.argsort(table.hp_mag, kind="stable"))
    table, merged = _merge(table, part_rad)
    table = table.take(np.argsort(table.hp_mag, kind="stable"))
    table = table.take(np.flatnonzero(table.hp_mag <= faintest_hp))
    if not len(table):
        raise BadInput(f"no star is brighter than Hp {faintest_hp:g}", mend="give a fainter limit")
    kept = tuple(m for m in merged if m.hp_mag <= faintest_hp)
    in_view = np.zeros(0, int) if field_rad is None else _stars_in_view(table, field_rad / 2)
    return CameraTable(table=table, merged=kept, stars_in_view=in_view)


def _merge(table: StarTable, part_rad: float) -> tuple[StarTable, list[Merged]]:
    """Each star not yet taken, brightest first, takes the free ones within part_rad of it."""
    v = sphere.unit_from_radec(table.ra_rad, table.dec_rad)
    near: dict[int, list[int]] = {}
    for a, b in sorted(cKDTree(v).query_pairs(2 * np.sin(part_rad / 2))):
        near.setdefault(a, []).append(b)
    names = ("hp_mag", "v_mag", "pm_ra_mas_yr", "pm_dec_mas_yr")
    columns = {name: np.array(getattr(table, name), float) for name in ("ra_rad", "dec_rad", *names)}
    taken, merged = np.zeros(len(table), bool), []
    for first in sorted(near):
        rows = [first, *(b for b in near[first] if not taken[b])]
        if taken[first] or len(rows) < 2:
            continue
        taken[rows[1:]] = True
        light = 10 ** (-0.4 * columns["hp_mag"][rows])
        share = light / light.sum()
        middle = share @ v[rows]
        shift = float(sphere.angle_between(middle, v[first]))
        columns["ra_rad"][first], columns["dec_rad"][first] = sphere.radec_from_unit(middle)
        for name in ("pm_ra_mas_yr", "pm_dec_mas_yr"):
            columns[name][first] = share @ columns[name][rows]
        for name in ("hp_mag", "v_mag"):
            columns[name][first] = -2.5 * np.log10((10 ** (-0.4 * columns[name][rows])).sum())
        merged.append(Merged(hip=tuple(int(h) for h in table.hip[rows]), shift_rad=shift,
                             hp_mag=float(columns["hp_mag"][first])))
    single = {name: columns[name].astype(getattr(table, name).dtype) for name in columns}
    every = {f: getattr(table, f) for f in table.__dataclass_fields__} | single
    return StarTable(**every).take(~taken), merged


def _stars_in_view(table: StarTable, radius_rad: float) -> np.ndarray:
    """Stars within radius_rad of VIEWS boresights spread evenly over the sky."""
    tree = cKDTree(sphere.unit_from_radec(table.ra_rad, table.dec_rad))
    return tree.query_ball_point(fibonacci_sphere(VIEWS), 2 * np.sin(radius_rad / 2), return_length=True)
