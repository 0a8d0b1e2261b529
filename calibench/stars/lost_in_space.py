"""LostInSpace: which stars are on a frame, with no prior knowledge of where it looks.

1. Believe something about the lens (the map's, or a ladder of fields and shapes), which gives a View.
2. The named identifier proposes correspondences; verify.py weeds them and judges the rest against all stars in view.
3. The first with a false-match probability below `accept` is the answer; else the best candidate and its odds are the reason.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import ModuleType
from typing import NamedTuple

import numpy as np

from .. import registry
from ..records import DISTORTION_NAMES, Identification, Intrinsics, Observer, Spots
from .per_lens import per_lens
from .refine import refine
from .sky_catalogue import SkyCatalogue
from .verify import ACCEPT, Match, Verifier
from .view import EVEN, GUESSED_MODEL_SD_PX, STRAIGHT, KnownLens, View, guessed_lens, guessed_view, horizontal_fov

DOUBTFUL = 1e-2  # below this, but not below the limit: a candidate was found and rejected
FEWEST_SPOTS = 4
PROVING_SPOTS = 6  # fewer leave at most two to bear out a triangle
GIVEN_FOV_SLACK = 0.12  # a field given by hand is believed to this fraction
SAME_FIELD = 0.03  # two lenses whose fields differ by less differ in something else
FOV_RANGE_RAD = (np.radians(5.0), np.radians(60.0))
# Along a ladder of unknown fields, neighbours differ by what an ideal lens bends between centre and edge: tan^2 of the half
# field changes by this much.
LADDER_STEP = 0.012
BENT_FROM_RAD = np.radians(25)  # narrower fields look alike whatever the lens does


def fov_ladder() -> list[tuple[float, float]]:
    """(fov_rad, scale_slack) covering FOV_RANGE_RAD (horizontal), narrow fields first.

    Below about 13 degrees every field looks alike to side ratios, so the first rung covers all of them.
    """
    low, high = (np.tan(f / 2) ** 2 for f in FOV_RANGE_RAD)
    rungs = []
    edge = low
    while edge < high:
        upper = edge + LADDER_STEP
        middle = np.sqrt((edge + upper) / 2)
        slack = 1.1 * max(np.sqrt(upper) / middle, middle / np.sqrt(edge)) - 1
        rungs.append((2 * float(np.arctan(middle)), float(slack)))
        edge = upper
    return rungs


def flipped(lens: Intrinsics) -> Intrinsics:
    """The same lens for images whose columns were reversed (x -> W - 1 - x): the tangential term p2 changes its sign."""
    distortion = lens.distortion.copy()
    covariance = lens.covariance.copy()
    odd = [2] + [4 + i for i, name in enumerate(DISTORTION_NAMES[lens.model]) if name == "p2"]
    distortion[[i - 4 for i in odd[1:]]] *= -1
    covariance[odd] *= -1
    covariance[:, odd] *= -1
    return replace(lens, cx_px=lens.image_size_px[0] - 1 - lens.cx_px, distortion=distortion, covariance=covariance,
                   mirrored=not lens.mirrored)


@per_lens
def ready(lens: Intrinsics) -> tuple[KnownLens, KnownLens]:
    """A map's lens, as it is and mirrored."""
    return KnownLens(lens), KnownLens(flipped(lens))


@dataclass
class LostInSpace:
    """An identifier with its tables for one sky; keeps the tables it has built.

    accept: the false-match probability below which a match is believed.
    keep: where tables outlive the run, given by whoever may touch the disk: keep(name, Table, build) gives the table of that
    name, built anew where it is not found. Without it tables live as long as this object.
    explain: how many frames that the given lens or field did not solve may in vain be searched once more with the lens left
    free, to say whether it is wrong. A reason only: the answer stays that there is none.
    """

    sky: SkyCatalogue
    method: str = "pattern"
    accept: float = ACCEPT
    tables: dict = field(default_factory=dict)
    keep: Callable[[str, type[NamedTuple], Callable[[], NamedTuple]], NamedTuple] | None = None
    explain: int = 0

    @cached_property
    def module(self) -> ModuleType:
        """The identifier (UsageError: no such method)."""
        return registry.load("calibench.stars.identify", self.method)

    def identify(self, spots: Spots, image_size_px: tuple[int, int], *, lens: Intrinsics | None = None,
                 fov_rad: float | None = None, familiar: Intrinsics | None = None) -> Identification:
        """Identify the stars of one frame.

        Args:
            lens: measured intrinsics, or None. fov_rad: horizontal field, where no lens is given. familiar: the lens fitted to
            an earlier frame of the series, tried first.

        Raises:
            UsageError: unknown method, or one that needs a lens or field and has none.
        """
        propose = self.module.propose
        if len(spots) < FEWEST_SPOTS:
            return Identification(status="too_few_spots", method=self.method,
                                  reason=f"{len(spots)} spots found, at least {FEWEST_SPOTS} are needed")
        verifier = Verifier(sky=self.sky, spots=spots, accept=self.accept)
        for view in self._views(spots, image_size_px, lens, fov_rad, familiar):
            verifier.grown = 0
            for spot_rows, star_rows in propose(view, self.sky, self.table(self.module.table_key(view))):
                if verifier.judge(view, spot_rows, star_rows):
                    break
            if verifier.done:
                return self._solved(verifier.best, spots, calibrated=lens is not None)
        return self._why_not(verifier, spots, image_size_px, lens, fov_rad)

    def table(self, key: object) -> NamedTuple:
        """The identifier's table of that key."""
        if (self.method, key) not in self.tables:
            def build() -> NamedTuple:
                # Of the sky at rest, so that a kept table does not depend on the day it was built.
                return self.module.build(SkyCatalogue.seen_by(self.sky.table, Observer()), key)
            name = f"{self.method}-{_digest(self.sky, key)}"
            self.tables[self.method, key] = self.keep(name, self.module.Table, build) if self.keep else build()
        return self.tables[self.method, key]

    def _views(self, spots: Spots, size: tuple[int, int], lens: Intrinsics | None, fov_rad: float | None,
               familiar: Intrinsics | None) -> Iterator[View]:
        if lens is not None:
            known, mirrored = ready(lens)
            yield known.view(spots)
            yield known.view(spots, drifted=True)
            yield mirrored.view(spots, drifted=True)  # the driver, or a wrong row order, may have mirrored the frame
            return
        rungs = fov_ladder() if fov_rad is None else [(fov_rad, GIVEN_FOV_SLACK)]
        if familiar is not None:
            bent = familiar.distortion[0] < EVEN[0] / 2
            yield guessed_view(spots, guessed_lens(horizontal_fov(familiar), size, EVEN if bent else STRAIGHT), GIVEN_FOV_SLACK)
        for shape, narrowest_rad in ((STRAIGHT, 0.0), (EVEN, BENT_FROM_RAD)):
            for fov, slack in rungs:
                if fov * (1 + slack) > narrowest_rad:
                    yield guessed_view(spots, guessed_lens(fov, size, shape), slack)

    def _solved(self, match: Match, spots: Spots, *, calibrated: bool) -> Identification:
        xy, covariance = spots.xy_px[match.spot_rows], spots.covariance_px2[match.spot_rows]
        directions, lens = self.sky.directions[match.star_rows], match.intrinsics
        if not calibrated:
            lens = refine(lens, match.matrix, xy, covariance, directions, GUESSED_MODEL_SD_PX)
        return Identification(status="solved", method=self.method, spot_rows=match.spot_rows, star_rows=match.star_rows,
                              xy_px=xy, covariance_px2=covariance, direction_icrs=directions, intrinsics=lens,
                              false_match_probability=match.false_match_probability)

    def _why_not(self, verifier: Verifier, spots: Spots, size: tuple[int, int], lens: Intrinsics | None,
                 fov_rad: float | None) -> Identification:
        suspect = self._suspect(spots, size, lens, fov_rad)
        best, tried = verifier.best, verifier.tried
        if best is None:
            return Identification(status="no_match", method=self.method,
                                  reason=f"none of {tried} patterns within tolerance was borne out by the other spots "
                                         f"({len(spots)} spots; {suspect})")
        odds = best.false_match_probability
        reason = (f"best of {tried} candidates matched {len(best.spot_rows)} of {len(spots)} spots, which happens by chance "
                  f"with probability {odds:.2g}, above the limit {self.accept:g}; {suspect}")
        return Identification(status="rejected" if odds < DOUBTFUL else "no_match", method=self.method, reason=reason,
                              false_match_probability=odds)

    def _suspect(self, spots: Spots, size: tuple[int, int], lens: Intrinsics | None, fov_rad: float | None) -> str:
        """What may be wrong where nothing was found; with `explain`, what the spots say when the lens is left free."""
        if len(spots) < PROVING_SPOTS:
            return "so few hardly prove anything"
        if lens is None and fov_rad is None:
            return "field between 5 and 60 degrees was tried"
        if self.explain <= 0:
            return "the field given may be wrong" if lens is None else "the map's lens may not be this camera's"
        found = replace(self, method="pattern").identify(spots, size)
        if found.status != "solved":
            self.explain -= 1
            return "nor does any lens of 5 to 60 degrees make them stars"
        given, there = np.degrees([fov_rad if lens is None else horizontal_fov(lens), horizontal_fov(found.intrinsics)])
        wrong = "field" if abs(there / given - 1) > SAME_FIELD else "lens"
        mirrored = ", mirrored" if found.intrinsics.mirrored else ""
        return (f"wrong {wrong} suspected: with the lens left free {len(found.spot_rows)} spots match{mirrored}, at "
                f"{there:.1f} degrees across, {given:.1f} were given")


def _digest(sky: SkyCatalogue, key: object) -> str:
    """What a table depends on besides the code that builds it: the stars and the key, in 16 hexadecimal digits."""
    table = sky.table
    stars = (table.hip, table.ra_rad, table.dec_rad, table.pm_ra_mas_yr, table.pm_dec_mas_yr, table.parallax_mas, table.hp_mag)
    digest = hashlib.sha256(repr((key, table.epoch_jyear)).encode())
    for column in stars:
        digest.update(np.ascontiguousarray(column).tobytes())
    return digest.hexdigest()[:16]
