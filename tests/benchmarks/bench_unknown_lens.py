"""A lens of which nothing is known: success, wrong answers, CPU over field and distortion; mirrored or not. `make bench`.

CALIBENCH_ATTITUDES: frames a cell (20). Half of the frames are mirrored; the fields are given to 10 %, or not at all.
1024 x 768 pixels, 0.15 px, the brightest stars of the whole table, the principal point off by 6 and 4 px.
"""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from calibench.io.star_table import load_star_table
from calibench.records import Intrinsics, Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.validate.simulated_spots import Condition, is_wrong, look

FRAMES = int(os.environ.get("CALIBENCH_ATTITUDES", 20))
SIZE = (1024, 768)
FIELDS_DEG = (6, 10, 20, 30, 40, 50, 60)
LENSES = {"ideal": ("brown4", 0, 0, 0, 0), "k1 +0.1": ("brown4", 0.1, 0, 0, 0), "k1 -0.1": ("brown4", -0.1, 0, 0, 0),
          "k1 -0.2": ("brown4", -0.2, 0, 0, 0), "k1 -0.35": ("brown4", -0.35, 0, 0, 0),
          "the thesis's": ("brown4", -0.37, 0.31, -0.0011, 0.0003), "r = f t": ("fisheye4", 0, 0, 0, 0)}
CONDITIONS = {"40 stars": Condition(noise_px=0.15, most=40),
              "25 stars, 5 false, 30 % missing": Condition(noise_px=0.15, most=25, false=5, missing=0.3)}
ATTITUDE_PX = 3.0  # what the stars of a right answer may be off by the principal point


def lens_of(fov_deg: float, kind: str, mirrored: bool) -> Intrinsics:
    model, *terms = LENSES[kind]
    edge = np.tan(np.radians(fov_deg / 2))
    bent = np.arctan(edge) if model == "fisheye4" else edge * (1 + terms[0] * edge**2 + terms[1] * edge**4)
    focal = SIZE[0] / 2 / bent
    return Intrinsics(model=model, fx_px=focal, fy_px=focal, cx_px=(SIZE[0] - 1) / 2 + 6, cy_px=(SIZE[1] - 1) / 2 - 4,
                      distortion=terms, image_size_px=SIZE, covariance=np.zeros((8, 8)), mirrored=mirrored)


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("given", [True, False])
def test_unknown_lens(condition, given):
    sky = SkyCatalogue.seen_by(load_star_table(), Observer())
    finder, wrong = LostInSpace(sky=sky), 0
    print(f"\n\n{condition}, field {'given to 10 %' if given else 'unknown'}, {FRAMES} frames: solved % / median CPU ms")
    print("degrees  " + "  ".join(f"{kind:>13}" for kind in LENSES))
    for fov_deg in FIELDS_DEG:
        cells = []
        for kind in LENSES:
            solved, spent = 0, []
            for seed in range(FRAMES):
                lens, rng = lens_of(fov_deg, kind, bool(seed % 2)), np.random.default_rng([20, seed])
                truth, spots = look(sky, lens, CONDITIONS[condition], rng)
                fov_rad = np.radians(fov_deg) * rng.uniform(0.9, 1.1) if given else None
                begin = time.process_time()
                found = finder.identify(spots, SIZE, fov_rad=fov_rad)
                spent.append(1e3 * (time.process_time() - begin))
                if found.status == "solved":
                    solved += 1
                    # under the lens that was fitted: where the found stars are on the true one
                    wrong += found.intrinsics.mirrored != lens.mirrored or is_wrong(found, truth, ATTITUDE_PX)
            cells.append(f"{100 * solved / FRAMES:6.0f} / {np.median(spent):4.0f}")
        print(f"{fov_deg:7}  " + "  ".join(f"{cell:>13}" for cell in cells), flush=True)
    assert wrong == 0
