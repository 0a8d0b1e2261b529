"""LostInSpace: which stars are on a frame, with no prior knowledge of where it looks.

1. Believe something about the lens (the map's, or a ladder of fields), which gives a View.
2. The named identifier proposes correspondences; `hypotheses` weeds them; the best supported are verified.
3. The first with a false-match probability below ACCEPT is the answer; else the best candidate and its odds are the reason.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from types import ModuleType

import numpy as np

from .. import registry
from ..records import DISTORTION_NAMES, Identification, Intrinsics, Spots
from .hypotheses import fit_hypotheses, supported
from .sky_catalogue import SkyCatalogue
from .verify import Match, verify
from .view import View, calibrated_view, focal_from_fov, guessed_view

ACCEPT = 1e-6  # false-match probability below which a match is believed
DOUBTFUL = 1e-2  # below this, but not below ACCEPT: a candidate was found and rejected
FEWEST_SPOTS = 4
MOST_VERIFIED = 40  # hypotheses of one view that are verified in full
GIVEN_FOV_SLACK = 0.12  # a field given by hand is believed to this fraction
FOV_RANGE_RAD = (np.radians(5.0), np.radians(60.0))
# Along a ladder of unknown fields, neighbours differ by what an ideal lens bends between centre and edge: tan^2 of the half
# field changes by this much.
LADDER_STEP = 0.012


def fov_ladder(image_size_px: tuple[int, int]) -> list[tuple[float, float]]:
    """(focal_px, scale_slack) covering FOV_RANGE_RAD (horizontal), narrow fields first.

    Below about 13 degrees every field looks alike to side ratios, so the first rung covers all of them.
    """
    low, high = (np.tan(f / 2) ** 2 for f in FOV_RANGE_RAD)
    rungs = []
    edge = low
    while edge < high:
        upper = edge + LADDER_STEP
        middle = np.sqrt((edge + upper) / 2)
        slack = 1.1 * max(np.sqrt(upper) / middle, middle / np.sqrt(edge)) - 1
        rungs.append((image_size_px[0] / 2 / middle, float(slack)))
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


@dataclass
class LostInSpace:
    """An identifier with its tables for one sky; keeps the tables it has built."""

    sky: SkyCatalogue
    method: str = "pattern"
    tables: dict = field(default_factory=dict)

    def identify(self, spots: Spots, image_size_px: tuple[int, int], *, lens: Intrinsics | None = None,
                 fov_rad: float | None = None, familiar: Intrinsics | None = None) -> Identification:
        """Identify the stars of one frame.

        Args:
            lens: measured intrinsics, or None. fov_rad: horizontal field, where no lens is given. familiar: the lens fitted to
            an earlier frame of the series, tried first.

        Raises:
            UsageError: unknown method, or one that needs a lens or field and has none.
        """
        module = registry.load("calibench.stars.identify", self.method)
        if len(spots) < FEWEST_SPOTS:
            return Identification(status="too_few_spots", method=self.method,
                                  reason=f"{len(spots)} spots found, at least {FEWEST_SPOTS} are needed")
        best, tried = None, 0
        for view in self._views(spots, image_size_px, lens, fov_rad, familiar):
            match, tried = self._search(module, view, spots, tried)
            if match and (best is None or match.false_match_probability < best.false_match_probability):
                best = match
            if best and best.false_match_probability < ACCEPT:
                return self._solved(best, spots)
        return self._why_not(best, tried, spots, lens is not None, fov_rad)

    def _views(self, spots: Spots, size: tuple[int, int], lens: Intrinsics | None, fov_rad: float | None,
               familiar: Intrinsics | None) -> Iterator[View]:
        if lens is not None:
            yield calibrated_view(spots, lens)
            yield calibrated_view(spots, flipped(lens))  # the driver, or a wrong row order, may have mirrored the frame
            return
        if familiar is not None:
            yield guessed_view(spots, size, familiar.fx_px, GIVEN_FOV_SLACK)
        if fov_rad is not None:
            yield guessed_view(spots, size, focal_from_fov(fov_rad, size), GIVEN_FOV_SLACK)
        else:
            for focal_px, slack in fov_ladder(size):
                yield guessed_view(spots, size, focal_px, slack)

    def _search(self, module: ModuleType, view: View, spots: Spots, tried: int) -> tuple[Match | None, int]:
        key = module.table_key(view)
        if (self.method, key) not in self.tables:
            self.tables[self.method, key] = module.build(self.sky, key)
        best, verified = None, 0
        for spot_rows, star_rows in module.propose(view, self.sky, self.tables[self.method, key]):
            if not len(spot_rows):
                continue
            hypotheses = fit_hypotheses(view, self.sky, spot_rows, star_rows)
            tried += len(hypotheses)
            hypotheses = supported(view, self.sky, hypotheses)
            for row in range(len(hypotheses)):
                if verified >= MOST_VERIFIED:
                    return best, tried
                verified += 1
                match = verify(view, spots.covariance_px2, self.sky, hypotheses.take(np.array([row])), tried)
                if match and (best is None or match.false_match_probability < best.false_match_probability):
                    best = match
                if best and best.false_match_probability < ACCEPT:
                    return best, tried
        return best, tried

    def _solved(self, match: Match, spots: Spots) -> Identification:
        return Identification(status="solved", method=self.method, spot_rows=match.spot_rows, star_rows=match.star_rows,
                              xy_px=spots.xy_px[match.spot_rows], covariance_px2=spots.covariance_px2[match.spot_rows],
                              direction_icrs=self.sky.directions[match.star_rows],
                              false_match_probability=match.false_match_probability, intrinsics=match.refined.intrinsics)

    def _why_not(self, best: Match | None, tried: int, spots: Spots, calibrated: bool, fov_rad: float | None) -> Identification:
        suspect = ("the map's lens may not be this camera's" if calibrated else
                   "the field given may be wrong" if fov_rad is not None else "field between 5 and 60 degrees was tried")
        if best is None:
            return Identification(status="no_match", method=self.method,
                                  reason=f"none of {tried} patterns within tolerance was borne out by the other spots "
                                         f"({len(spots)} spots; {suspect})")
        odds = best.false_match_probability
        reason = (f"best of {tried} candidates matched {len(best.spot_rows)} of {len(spots)} spots, which happens by chance "
                  f"with probability {odds:.2g}, above the limit {ACCEPT:g}; {suspect}")
        return Identification(status="rejected" if odds < DOUBTFUL else "no_match", method=self.method, reason=reason,
                              false_match_probability=odds)
