"""A raw frame, of which windows are corrected, is solved as one that is corrected whole."""

import numpy as np
from scipy.spatial.transform import Rotation

from calibench.geometry import projection, rotation
from calibench.io.star_table import load_star_table
from calibench.records import CalibrationMap, Frame, Intrinsics, Observer
from calibench.stars.lost_in_space import LostInSpace
from calibench.stars.sky_catalogue import SkyCatalogue
from calibench.stars.solve import STAGES, Solver

SIZE, SIGMA_PX = (752, 480), 0.9


def test_windows_corrected_give_the_same_attitude():
    rng, sky = np.random.default_rng(60), SkyCatalogue.seen_by(load_star_table(), Observer())
    lens = Intrinsics(model="brown4", fx_px=1416.7, fy_px=1416.7, cx_px=380.0, cy_px=236.0, distortion=[-0.3, 0.2, 1e-3, 3e-4],
                      image_size_px=SIZE, covariance=np.diag([0.04, 0.04, 0.04, 0.04, 1e-6, 1e-6, 1e-10, 1e-10]))
    offset = (64 + rng.normal(0, 2, SIZE[::-1])).astype(np.float32)
    calmap = CalibrationMap(image_size_px=SIZE, intrinsics=lens, offset_dn=offset, gain_dn_per_e=0.1,
                            read_noise_dn=np.ones(SIZE[::-1], np.float32),
                            measured=frozenset({"intrinsics", "offset_dn", "read_noise_dn", "gain_dn_per_e"}))
    solver, other = (Solver(finder=LostInSpace(sky=sky), detector=detector) for detector in ("scan", "components"))
    columns, lines = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    for _ in range(2):
        truth = Rotation.random(random_state=rng).as_matrix()
        rows = np.flatnonzero((sky.directions @ truth[2] > 0.9) & (sky.magnitude < 5.5))
        xy = projection.project(lens, sky.directions[rows] @ truth.T)
        light = np.full(SIZE[::-1], 50.0)
        for (x, y), magnitude in zip(xy, sky.magnitude[rows], strict=True):
            if 5 < x < SIZE[0] - 6 and 5 < y < SIZE[1] - 6:
                window = np.s_[int(y) - 5:int(y) + 7, int(x) - 5:int(x) + 7]
                far2 = (columns[window] - x)**2 + (lines[window] - y)**2
                electrons = 4e5 * 10 ** (-0.4 * (magnitude - 1))
                light[window] += electrons / (2 * np.pi * SIGMA_PX**2) * np.exp(-far2 / 2 / SIGMA_PX**2)
        data = offset + 0.1 * rng.poisson(light) + rng.normal(0, 1, light.shape)
        frame = Frame(data=np.clip(np.rint(data), 0, 1023).astype(np.uint16), bit_depth=10, white_level_dn=1023, exposure_s=0.1)
        fast, whole = solver.solve(frame, calmap), other.solve(frame, calmap)
        assert fast.status == whole.status == "solved"
        matrices = [rotation.matrix_from_quaternion(s.attitude.q_cam_icrs) for s in (fast, whole)]
        sigma = max(fast.sigma_cross_rad, fast.sigma_roll_rad)
        for a, b in ((matrices[0], truth), (matrices[0], matrices[1])):
            assert Rotation.from_matrix(a @ b.T).magnitude() < 6 * sigma
        assert tuple(fast.timings_s) == STAGES and fast.timings_s["correct"] == 0 < whole.timings_s["correct"]
