"""Parameters of one plane from its curve and its darks, each with its 1-sigma error (EMVA 1288 R4 Linear, sections 6 and 7)."""

from __future__ import annotations

import numpy as np

from ...errors import BadInput
from .._dark.limits import MAX_RATE_E_PER_S, QUANTISATION_DN2
from .._transfer import BEYOND_CHANCE, Line, line, variance_line
from .curve import FITTED_FILL, Curve, Darks
from .figure import Figure

MIN_LEVELS = 3
FLOOR_DN2, FLOOR_SD_DN = 0.24, 0.49  # below, quantisation hides the noise: an upper limit is given
LINEAR_FILL = (0.05, 0.95)
CERTAIN = 0.6827  # what one sigma covers
DRAWS = 2000


def gain(curve: Curve) -> tuple[Figure, Line]:
    """K in DN/e-, and the line of variance over signal.

    Raises:
        BadInput: too few levels below 70 % of saturation, or a variance that does not grow with the light.
    """
    fitted = curve.fitted
    if fitted.sum() < MIN_LEVELS:
        raise BadInput(f"{fitted.sum()} light levels lie below 70 % of saturation, the gain needs {MIN_LEVELS}; the dimmest "
                       f"has {curve.mean_dn[0]:.0f} DN of {curve.top_dn:.0f}{_most(curve)}",
                       mend="take a ladder of about 50 (at least 9) even steps from dark to saturation, two frames each")
    found = variance_line(*(values[fitted] for values in (
        curve.signal_dn, curve.variance_dn2, np.maximum(curve.variance_error_dn2, 1e-12), curve.noise_dn2)))
    if not found.slope > 3 * found.slope_error:
        raise BadInput(f"the variance does not grow with the light (slope {found.slope:.3g} +- {found.slope_error:.2g})",
                       mend="were darks and bright frames swapped, or the frames processed or copied?")
    bend = _bend_percent(curve.signal_dn[fitted], curve.variance_dn2[fitted], found.slope)
    how = "" if found.weighted else f"levels scatter about the line beyond their errors (chi2/dof {found.chi2:.1f})"
    return Figure(found.slope, found.slope_error, how + (f"; local slopes differ by {bend:.1f} %" if how else "")), found


def _most(curve: Curve) -> str:
    """The light at which the range would be full, as the dimmest level has it; it is less where that is clipped itself."""
    if not curve.light_unit or curve.signal_dn[0] <= 0:
        return ""
    full = curve.light[0] * (curve.top_dn - curve.mean_dn[0] + curve.signal_dn[0]) / curve.signal_dn[0]
    return f": at most {FITTED_FILL * full:.2g} {curve.light_unit} would be right"


def _bend_percent(signal: np.ndarray, variance: np.ndarray, slope: float) -> float:
    """Mean relative deviation of the local slope from K; a parabola stands for the standard's spline."""
    if len(signal) < 2 * MIN_LEVELS:
        return 0.0
    square = np.polyfit(signal, variance, 2)[0]
    return float(100 * np.mean(np.abs(2 * square * (signal - signal.mean()))) / slope)


def responsivity(curve: Curve) -> Figure:
    """R in DN per photon: the slope of signal over photons through zero, every level alike."""
    if curve.light_unit != "photons":
        return Figure(None, None, "photons per pixel not stated (irradiance, or a descriptor): R and QE are left out")
    x, y = curve.light[curve.fitted], curve.signal_dn[curve.fitted]
    slope, known = float(x @ y / (x @ x)), curve.signal_error_dn[curve.fitted]
    residual = y - slope * x
    freedom = len(x) - 1
    if np.sum((residual / known) ** 2) > freedom + BEYOND_CHANCE * np.sqrt(2 * freedom):  # more than noise: bent, or the lamp
        known = residual / (1 - x**2 / (x @ x))  # of each level to the slope without it
    return Figure(slope, float(np.linalg.norm(x * known) / (x @ x)), "its error is without that of the irradiance")


def dark_noise(darks: Darks) -> Figure:
    """sigma_y.dark in DN at the shortest exposure, quantisation included."""
    variance, error = float(darks.variance_dn2[0]), float(darks.variance_error_dn2[0])
    if variance < FLOOR_DN2:
        return Figure(FLOOR_SD_DN, float(max(FLOOR_SD_DN - np.sqrt(variance), error)),
                      f"upper limit: the temporal variance {variance:.3g} DN^2 is below 0.24, quantisation hides the noise")
    return Figure(float(np.sqrt(variance)), error / (2 * float(np.sqrt(variance))))


def read_noise_dn(sigma_y_dark: Figure) -> Figure:
    """sigma_d times K: without the quantisation variance."""
    value = float(np.sqrt(sigma_y_dark.value**2 - QUANTISATION_DN2))
    return Figure(value, sigma_y_dark.error * sigma_y_dark.value / value, sigma_y_dark.reason)


def threshold_dn(sigma_y_dark: Figure, gain: Figure) -> Figure:
    """mu_e.min times K: the signal that equals its noise. In DN the gain hardly enters; the error holds what it does."""
    noise, k = sigma_y_dark.value, gain.value
    root = float(np.hypot(noise, k / 2))
    return Figure(root + k / 2, float(np.hypot(sigma_y_dark.error * noise / root, gain.error * (k / (4 * root) + 0.5))),
                  sigma_y_dark.reason)


def threshold_e(sigma_y_dark: Figure, gain: Figure) -> Figure:
    """mu_e.min: the charge at which the signal equals its noise."""
    noise = sigma_y_dark.over(gain)
    root = float(np.sqrt(noise.value**2 + 0.25))
    return Figure(root + 0.5, noise.error * noise.value / root, sigma_y_dark.reason)


def saturation(curve: Curve) -> tuple[Figure, Figure]:
    """Signal in DN and light at saturation: of the last level before it, as the standard has it. The sensor is full somewhere
    in the step above; the error is the part of that step in which it is with 68 %."""
    i = curve.saturation
    if i is None:
        reason = (f"saturation not reached: the brightest level is {curve.mean_dn[-1]:.0f} DN of {curve.top_dn:.0f}, "
                  f"so more than {curve.signal_dn[-1]:.0f} DN above dark")
        return Figure(None, None, reason), Figure(None, None, reason)
    step = min(i + 1, len(curve.mean_dn) - 1)

    def at(values: np.ndarray) -> Figure:
        gap = max(values[step] - values[i], values[i] - values[max(i - 1, 0)])
        return Figure(float(values[i]), float(CERTAIN * gap), f"{curve.saturated_by}; full lies in the ladder's step above it")
    return at(curve.signal_dn), at(curve.light)


def linearity_error(curve: Curve) -> tuple[Figure, np.ndarray, np.ndarray]:
    """LE in %: mean absolute relative deviation from the line of least relative squares, over 5 to 95 % of saturation.

    Noise alone makes this mean larger than zero. The error is what covers the noise-free figure in 68 % of draws of the levels'
    noise about deviations that are drawn in towards the line as far as their scatter may be noise.

    Returns:
        LE, the levels used (K,) bool, and their deviations in %.
    """
    none = np.zeros(len(curve.signal_dn), bool)
    if not curve.light_unit:
        return Figure(None, None, "neither photons nor different exposures are stated"), none, np.zeros(0)
    used = curve.below(LINEAR_FILL[1], LINEAR_FILL[0]) & (curve.signal_dn > 0)
    if used.sum() < MIN_LEVELS:
        return Figure(None, None, "fewer than 3 levels between 5 and 95 % of saturation"), none, np.zeros(0)
    x, y = curve.light[used], curve.signal_dn[used]
    design = np.stack([np.ones_like(x), x], -1) / y[:, None]
    solver = np.linalg.pinv(design) / y
    line_dn = design @ (solver @ y) * y
    deviation = 100 * (y - line_dn) / line_dn
    found = float(np.mean(np.abs(deviation)))
    by_level = 100 * (np.eye(len(x)) - (y / line_dn)[:, None] * (design * y[:, None] @ solver)) / line_dn[:, None]
    noise = by_level * curve.signal_error_dn[used] @ np.random.default_rng(0).standard_normal((len(x), DRAWS))
    chance = float(np.mean(noise**2)) * (1 + np.sqrt(2 / len(x)))
    bent = deviation * np.sqrt(max(1 - chance / np.mean(deviation**2), 0.0))
    drawn = np.mean(np.abs(bent[:, None] + noise), axis=0)
    error = np.quantile(np.abs(drawn - np.mean(np.abs(bent))), CERTAIN)
    remark = f"noise alone makes {np.mean(np.abs(noise)):.2g} %"
    if curve.saturation is None:
        remark += "; saturation not reached: over the levels there are"
    return Figure(found, float(error), remark), used, deviation


def dark_current(darks: Darks, gain: Figure) -> tuple[Figure, Figure, Figure]:
    """Mean level at zero exposure (DN), dark current from the mean and from the variance (e-/s).

    Raises:
        BadInput: the rate is absurd, as it is where the unit of time is wrong.
    """
    t = darks.exposure_s
    if not np.isfinite(t).all() or len(t) < 2:
        reason = "exposure unknown" if not np.isfinite(t).all() else f"needs darks of several exposures, not of {t[0]:g} s only"
        remark = f"at {t[0]:g} s" if np.isfinite(t[0]) else "exposure unknown"
        none = Figure(None, None, reason)
        return Figure(float(darks.mean_dn[0]), float(darks.mean_error_dn[0]), remark), none, none
    remark = "" if len(t) >= 6 else f"{len(t)} exposures; the standard wants 6"
    mean = line(t, darks.mean_dn, np.maximum(darks.mean_error_dn, 1e-12))
    variance = variance_line(t, darks.variance_dn2, np.maximum(darks.variance_error_dn2, 1e-12), darks.variance_dn2.clip(1e-12))
    current = Figure(mean.slope, mean.slope_error, remark).over(gain)
    if abs(current.value) > MAX_RATE_E_PER_S and abs(mean.slope) > 5 * mean.slope_error:
        raise BadInput(f"a mean dark current of {current.value:.3g} e-/s is absurd", mend="give exposures in seconds "
                       "(in nanoseconds in a descriptor); were frames of different exposure mixed up?")
    # uncertain twice over: the gain enters the variance squared
    squared = Figure(gain.value**2, 2 * gain.value * gain.error)
    return (Figure(mean.offset, mean.offset_error, ""), current,
            Figure(variance.slope, variance.slope_error, remark).over(squared))
