"""Residuals on real frames beside cedar-solve's: each with its own centroids, cedar-solve with ours, and both on the stars that
both matched. `make bench`.

CALIBENCH_REAL: the folder of real frames (else shared/real beside the project). CALIBENCH_CEDAR_PYTHON: a Python that has
cedar-solve; it is told the horizontal field, ours only that of esa_tetra3. It fits attitude and field, ours distortion too;
"same model": attitude and focal length fitted alike to either's centroids of the common stars.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibench.geometry import projection, rotation
from calibench.io.frames import read_frame
from calibench.session.sky import Sky

SETS = {"esa_tetra3": 11.4, "creusot_16mm": None, "cedar_medium": None}
SAME_PX = 2.0  # a spot of ours and one of the peer's this near are one
ARCSEC = 180 * 3600 / np.pi
CEDAR = """
import json, sys, logging, numpy as np, tetra3
from PIL import Image
logging.disable(logging.CRITICAL)
t3, out = tetra3.Tetra3('default_database'), []
for frame in json.load(open(sys.argv[1])):
    image = Image.open(frame['file'])
    image = Image.fromarray((np.array(image) / 16).astype(np.float32)) if image.mode.startswith('I') else image.convert('L')
    w, h = frame['size']
    answers = []
    for centroids in (tetra3.get_centroids_from_image(image), np.array(frame['spots']).reshape(-1, 2)[:, ::-1] + 0.5):
        f = t3.solve_from_centroids(np.array(centroids)[:60], (h, w), fov_estimate=frame['fov'], fov_max_error=1.5,
                                    return_matches=True)
        answers.append(f['RA'] is not None and (f['RMSE'], [(x - 0.5, y - 0.5) for y, x in f['matched_centroids']]))
    out.append(answers)
print(json.dumps(out))
"""


def rms_arcsec(off_rad: np.ndarray) -> float:
    return float(np.sqrt((off_rad**2).sum(-1).mean()) * ARCSEC)


def of_same_model(xy: np.ndarray, stars: np.ndarray, size: tuple[int, int], focal: float) -> float:
    """Residual, arcsec rms, of spots (M, 2) of stars (M, 3) under the best attitude and focal length."""
    def off(f: np.ndarray) -> np.ndarray:
        v = np.column_stack([(xy - (np.array(size) - 1) / 2) / (f[0] * focal), np.ones(len(xy))])
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        return v - Rotation.align_vectors(v, stars)[0].apply(stars)
    return rms_arcsec(off(least_squares(lambda f: off(f).ravel(), [1.0], x_scale=1e-3).x))


@pytest.mark.parametrize("name", SETS)
def test_residuals(real, tmp_path, name):
    python, sky, frames, ours = os.environ.get("CALIBENCH_CEDAR_PYTHON"), Sky(), [], []
    with (real / "stars" / name / "truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        path = real / "stars" / name / row["file"]
        frame = read_frame(path, "light")
        solution = sky.solve(frame, None, fov_rad=np.radians(SETS[name]) if SETS[name] else None).solution
        assert solution.status == "solved"
        found, matrix = solution.identification, rotation.matrix_from_quaternion(solution.attitude.q_cam_icrs)
        ours.append((found, projection.unproject(found.intrinsics, found.xy_px) - found.direction_icrs @ matrix.T))
        frames.append({"file": str(path), "size": frame.image_size_px, "fov": float(row["fov_deg"]),
                       "spots": solution.spots.xy_px.tolist()})
    print(f"\n\n{name}, {len(frames)} frames; medians\nours, all stars: {np.median([len(off) for _, off in ours]):.0f} stars, "
          f"{np.median([rms_arcsec(off) for _, off in ours]):.2f} arcsec")
    if not python:
        pytest.skip("CALIBENCH_CEDAR_PYTHON does not name a Python that has cedar-solve")
    (tmp_path / "frames.json").write_text(json.dumps(frames))
    run = subprocess.run([python, "-c", CEDAR, str(tmp_path / "frames.json")], capture_output=True, text=True, check=True)
    table = []
    for frame, (found, off), (own, fed) in zip(frames, ours, json.loads(run.stdout.splitlines()[-1]), strict=True):
        if not own:
            continue
        apart = np.hypot(*(found.xy_px[:, None] - np.array(own[1])).transpose(2, 0, 1))
        mine, theirs = apart.argmin(0)[apart.min(0) < SAME_PX], np.array(own[1])[apart.min(0) < SAME_PX]
        stars = found.direction_icrs[mine]
        same = [of_same_model(xy, stars, frame["size"], found.intrinsics.fx_px) for xy in (found.xy_px[mine], theirs)]
        table.append((len(own[1]), own[0], len(fed[1]) if fed else np.nan, fed[0] if fed else np.nan, len(mine),
                      rms_arcsec(off[mine]), *same))
    table = np.array(table)
    n, rms, fed_n, fed_rms, common, here, same_ours, same_theirs = np.nanmedian(table, 0)
    print(f"cedar-solve, own centroids: {n:.0f} stars, {rms:.2f} arcsec, {len(table)} solved; with ours: {fed_n:.0f} stars, "
          f"{fed_rms:.2f} arcsec\nours on the {common:.0f} stars of both: {here:.2f} arcsec, at or below in "
          f"{(table[:, 5] <= table[:, 1]).sum()} of {len(table)} frames\nsame model, same stars: ours {same_ours:.2f}, "
          f"cedar-solve's {same_theirs:.2f}, at or below in {(table[:, 6] <= table[:, 7]).sum()} of {len(table)}")
    assert here <= rms
