"""The attitude of an identified frame: Wahba's problem by the named method, outliers out, covariance from the spots' own.

1. Directions of the matched spots through the lens, weights from their covariance.
2. The named method's rotation R; residuals in pixels.
3. While one star misses by more than OUTLIER_SIGMA of its own and the frame's errors, the worst is left out and 2 repeated.
4. Covariance, random part, by linear propagation through the method as it weighs the stars (a_i), with u_i = R r_i and spot
   covariance S_i in the tangent plane:
                           F d = sum a_i u_i x e_i,   F = sum a_i (I - u_i u_i'),
                           P = F^-1 (sum a_i^2 [u_i]x S_i [u_i]x') F^-1.
   It is honest for any weights, the best ones or not. Where the smallest chi^2 that any rotation could reach says that the
   stars miss by more than their errors (beyond 3 sigma of chance), P is scaled by chi^2 over the degrees of freedom.
"""

from __future__ import annotations

import numpy as np

from .. import registry
from ..errors import BadInput
from ..geometry import kernels as geometry_kernels
from ..geometry import projection, rotation
from ..records import Attitude, Identification
from .attitude import kernels
from .kernels import widening
from .per_lens import lens_terms
from .view import CALIBRATED_MODEL_SD_PX, GUESSED_MODEL_SD_PX

OUTLIER_SIGMA = 5.0
FEWEST_STARS = 4
MOST_REJECTED = 0.25  # of the stars: where more of them miss, the frame's errors are larger than stated and no star is to blame
LARGEST_SD_RAD = 0.1  # a rotation less sure than this about some axis is not observed
NOTHING = np.zeros((0, 0))
NOTHING.flags.writeable = False  # as a record's arrays are: one compiled form serves both


def model_variance_px2(calibrated: bool) -> float:
    """What the lens model itself may be off, px^2."""
    return (CALIBRATED_MODEL_SD_PX if calibrated else GUESSED_MODEL_SD_PX) ** 2


def spot_weights(found: Identification, *, calibrated: bool) -> np.ndarray:
    """Inverse covariance (M, 2, 2), px^-2, of the matched spots, with what the lens model itself may be off."""
    return np.linalg.inv(found.covariance_px2 + np.eye(2) * model_variance_px2(calibrated))


def attitude_without_outliers(found: Identification, method: str, *, calibrated: bool) -> tuple[Identification, Attitude]:
    """The attitude and the stars that it rests on.

    calibrated: the lens comes from a map. An attitude that the stars do not determine has the status `rejected`.

    Raises:
        UsageError: unknown method.
    """
    most = int(MOST_REJECTED * len(found.spot_rows))
    try:
        attitude = find_attitude(found, method, calibrated=calibrated)
        for rejected in range(most + 1):
            off = _misses(attitude.residual_px, found, calibrated)
            worst = int(np.argmax(off))
            if off[worst] <= OUTLIER_SIGMA or rejected == most or len(off) <= FEWEST_STARS:
                break
            found = found.take(np.arange(len(off)) != worst)
            attitude = find_attitude(found, method, calibrated=calibrated)
    except BadInput as fault:
        return found, Attitude.unsolved(status="rejected", method=method, reason=f"no attitude: {fault.what}")
    if not max(np.diagonal(attitude.covariance_rad2).tolist()) < LARGEST_SD_RAD**2:
        return found, Attitude.unsolved(status="rejected", method=method, reason="the stars are too close together to tell "
                                        "the rotation about them")
    return found, attitude


def find_attitude(found: Identification, method: str, *, calibrated: bool) -> Attitude:
    """Attitude of an identified frame from all its stars (steps 1, 2 and 4).

    Raises:
        UsageError: unknown method. BadInput: the stars' directions do not determine a rotation.
    """
    lens, own, model = found.intrinsics, found.covariance_px2, model_variance_px2(calibrated)
    module, camera, terms = registry.load("calibench.stars.attitude", method), lens_terms(lens), len(lens.distortion)
    v = geometry_kernels.unproject(*camera, found.xy_px)
    if np.isnan(v).any():
        projection.unproject(lens, found.xy_px)  # says which pixel, and why
    _, measured_by_v, _ = kernels.project(*camera, terms, v)
    weight = 1 / kernels.direction_variance(measured_by_v, own, model)
    matrix = module.attitude(v, found.direction_icrs, weight)
    u = found.direction_icrs @ matrix.T
    xy, by_v, by_p = kernels.project(*camera, terms, u)
    residual = found.xy_px - xy
    # What the lens's own covariance lets expect is no surprise: it is told apart, as the systematic part.
    expected = lens.covariance if calibrated and np.isfinite(lens.covariance).all() else NOTHING
    covariance, chi2 = kernels.spread(measured_by_v, module.effective_weights(v, weight), own, 0.0 if calibrated else model, u,
                                      by_v, by_p, expected, residual)
    freedom = max(2 * len(residual) - 3, 1)
    scale = widening(chi2, freedom)
    return Attitude(status="solved", method=method, q_cam_icrs=rotation.quaternion_from_matrix(matrix),
                    covariance_rad2=covariance * scale, residual_px=residual)


def _misses(residual: np.ndarray, found: Identification, calibrated: bool) -> np.ndarray:
    """How many sigma each star (M,) misses by: of its own error, and of the frame's typical one where that is larger."""
    d2 = kernels.misses2(residual, found.covariance_px2, model_variance_px2(calibrated))
    middle = float(np.partition(d2, len(d2) // 2)[len(d2) // 2])
    typical = max(middle / (2 * np.log(2)), 1.0)  # the median of chi^2 with two degrees of freedom is 2 ln 2
    return np.sqrt(d2 / typical)
