"""One plane (a whole monochrome sensor, or one colour of a mosaic) from its levels to all its figures and curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...records import Quantity
from .. import _nonuniformity as spatial
from . import parameters, patterns
from .crosstalk import Crosstalk, crosstalk, lag
from .curve import Curve, Darks, curve_of
from .figure import Figure
from .levels import Level

R4 = "EMVA 1288 R4 Linear, "


@dataclass(frozen=True, kw_only=True)
class Image:
    """Mean image (H, W) float32 of a stack above a whole number of DN, so that single precision is enough, and its level."""

    base_dn: int
    above_dn: np.ndarray
    level: Level

    @property
    def temporal_dn2(self) -> float:
        """Temporal variance that is left in the mean."""
        return self.level.variance_dn2 / self.level.count


@dataclass(frozen=True, kw_only=True)
class Plane:
    """What one plane shows. `curve` for the corrections and warnings that concern all planes."""

    quantities: tuple[Quantity, ...]
    evidence: dict[str, np.ndarray]
    curve: Curve
    gain: Figure
    crosstalk: Crosstalk
    lag: Figure


def analyse(levels: Sequence[Level], darks: Darks, dark: Image | None, bright: Image | None, white_level_dn: float) -> Plane:
    """Figures of a plane.

    Args:
        levels: of light. dark, bright: the stacks for the nonuniformity; None: there is none.

    Raises:
        BadInput: the levels do not make a transfer curve.
    """
    curve = curve_of(levels, darks, white_level_dn)
    gain, line = parameters.gain(curve)
    out = _Sheet()
    r = parameters.responsivity(curve)
    noise_dn = parameters.dark_noise(darks)
    read_dn = parameters.read_noise_dn(noise_dn)
    k = gain._replace(reason="")
    eta = r.over(k)._replace(reason=r.reason)
    floor_dn = parameters.threshold_dn(noise_dn, k)
    floor_photons = floor_dn.over(r)
    full_dn, full_light = parameters.saturation(curve)
    full_e = full_dn.over(k) if r.value is None else full_light.over(eta.power(-1.0))
    reach = full_dn.over(floor_dn) if r.value is None else full_light.over(floor_photons)
    snr = full_e.power(0.5)
    shared = crosstalk(curve, levels[0].pixels, k)
    late = lag(bright and bright.level)
    error_percent, linear, deviation = parameters.linearity_error(curve)
    offset, current, current_variance = parameters.dark_current(darks, k)

    how = f"slope over {curve.fitted.sum()} levels, free offset, {'weighted' if line.weighted else 'every level alike'}"
    out.add("gain_dn_per_e", "K", "DN/e-", f"6.6: {how}", gain)
    out.add("gain_e_per_dn", "1/K", "e-/DN", "6.6", gain.power(-1.0))
    out.add("responsivity_dn_per_photon", "R", "DN/photon", "6.6: slope through zero, up to 70 % of saturation", r)
    out.add("quantum_efficiency_percent", "eta", "%", "6.6: R/K", eta.times(100))
    out.add("dark_noise_dn", "sigma_y.dark", "DN", "6.6: shortest exposure, quantisation included", noise_dn)
    out.add("read_noise_dn", "sigma_d K", "DN", "6.6: quantisation variance 1/12 DN^2 subtracted", read_dn)
    out.add("read_noise_e", "sigma_d", "e-", "6.6: shortest exposure, quantisation variance subtracted", read_dn.over(k))
    out.add("absolute_threshold_e", "mu_e.min", "e-", "6.7", parameters.threshold_e(noise_dn, k))
    out.add("absolute_threshold_photons", "mu_p.min", "photons/pixel", "6.7", floor_photons)
    out.add("saturation_dn", "mu_y.sat - mu_y.dark", "DN", "6.6", full_dn)
    out.add("saturation_photons", "mu_p.sat", "photons/pixel", "6.6",
            full_light if curve.light_unit == "photons" else Figure(None, None, r.reason))
    out.add("saturation_e", "mu_e.sat", "e-", "6.7", full_e)
    out.add("snr_max", "SNR_max", "1", "6.7", snr)
    out.add("snr_max_db", "SNR_max", "dB", "6.7", snr.decibel())
    out.add("snr_max_inverse_percent", "1/SNR_max", "%", "6.7", snr.power(-1.0).times(100))
    out.add("dynamic_range", "DR", "1", "6.7: mu_p.sat / mu_p.min", reach)
    out.add("dynamic_range_db", "DR", "dB", "6.7: mu_p.sat / mu_p.min", reach.decibel())
    out.add("linearity_error_percent", "LE", "%", "6.8: mean absolute deviation, 5 to 95 % of saturation", error_percent)
    out.add("offset_dn", "mu_y.dark", "DN", "7: dark level at zero exposure", offset)
    out.add("dark_rate_dn_per_s", "mu_I K", "DN/s", "7: from the mean dark level", _product(current, k))
    out.add("dark_current_e_per_s", "mu_I.mean", "e-/s", "7.1: from the mean dark level", current)
    out.add("dark_current_from_variance_e_per_s", "mu_I.var", "e-/s", "7.1: from the temporal variance", current_variance)
    dsnu, prnu, patterns_shown = _patterns(out, dark, bright, k)
    ours = "not in the standard"
    for axis, correlation, coupling, what in zip("xy", shared.correlation, shared.coupling_percent, ("right", "lower"),
                                                 strict=True):
        out.add(f"noise_correlation_{axis}", f"rho_{axis}", "1", f"photon noise, with the {what} neighbour; {ours}",
                correlation)
        out.add(f"crosstalk_{axis}_percent", f"alpha_{axis}", "%", "charge that shows in each neighbour along "
                f"{axis}, from the photon noise; {ours}", coupling)
    out.add("gain_crosstalk_corrected_dn_per_e", "K.c", "DN/e-", f"K times the photon noise's summed autocorrelation; {ours}",
            shared.gain)
    out.add("frame_correlation", "rho_t", "1", f"noise of consecutive frames: 1 - variance of a pair / a stack; {ours}", late)

    charge = np.maximum(curve.signal_dn, 0) / k.value
    other = noise_dn.value**2 / k.value**2 + dsnu**2 + charge + (prnu / 100 * charge) ** 2
    evidence = {
        "light": curve.light, "mean_dn": curve.mean_dn, "signal_dn": curve.signal_dn, "variance_dn2": curve.variance_dn2,
        "variance_uncertainty_dn2": curve.variance_error_dn2, "at_top": curve.at_top, "fitted": curve.fitted.astype(np.uint8),
        "line": np.array([line.slope, line.offset]), "charge_e": charge,
        "snr": curve.signal_dn / np.sqrt(curve.noise_dn2.clip(1e-9)),
        "snr_total": charge / np.sqrt(other), "linear": linear.astype(np.uint8), "linearity_deviation_percent": deviation,
        "flicker": curve.flicker, "correlation": curve.correlation, **_dark_curve(darks), **patterns_shown}
    return Plane(quantities=tuple(out.rows), evidence=evidence, curve=curve, gain=gain, crosstalk=shared, lag=late)


class _Sheet:
    """The figures of the datasheet, in its order."""

    def __init__(self) -> None:
        self.rows: list[Quantity] = []

    def add(self, name: str, symbol: str, unit: str, section: str, figure: Figure) -> None:
        source = section if "standard" in section else R4 + section
        self.rows.append(Quantity(name=name, symbol=symbol, unit=unit, source=source, value=figure.value,
                                  uncertainty=figure.error, reason=figure.reason))


def _patterns(out: _Sheet, dark: Image | None, bright: Image | None, gain: Figure) -> tuple[float, float, dict]:
    """DSNU and PRNU: raw, release 4, core, each split. Returns DSNU1288 in e-, PRNU1288 in % (0: none) and the curves."""
    shown: dict[str, np.ndarray] = {}
    kinds = (("1288", "8.1: high-passed, all pixels"), ("raw", "8.1 without the high-pass, all pixels"),
             ("core", "8.1: high-passed, interquartile range; not in the standard"))
    found: dict[str, dict[str, dict]] = {}
    for what, image in (("dark", dark), ("bright", bright)):
        if image is None:
            continue
        filtered = spatial.high_pass(image.above_dn)
        t = image.temporal_dn2
        raw, passed = (spatial.split(i, t, filtered=f) for i, f in ((image.above_dn, False), (filtered, True)))
        found[what] = {"raw": vars(raw), "1288": vars(passed), "core": {"total": spatial.spatial_core(filtered, t, passed)}}
        shown |= _shown(what, image, filtered)
    reason = "no dark frames at which the pattern could be read" if dark is None else "no lit stack"
    values = {"dsnu": 0.0, "prnu": 0.0}
    for kind, section in kinds:
        for part in ("total", "row", "column", "pixel")[: 1 if kind == "core" else 4]:
            name = f"{kind}_{part}" if part != "total" else kind
            below = found.get("dark", {}).get(kind, {}).get(part)
            above = found.get("bright", {}).get(kind, {}).get(part)
            dsnu = prnu = Figure(None, None, reason)
            if below is not None:
                dsnu = _root(below, "DN^2").over(gain)
            if below is not None and above is not None:
                signal = bright.level.mean_dn - dark.level.mean_dn
                prnu = _root(spatial.difference(above, below, signal / 100), "%^2")
            when = "" if dark is None or dark.level.exposure_s is None else f"; at {dark.level.exposure_s:g} s"
            symbol = f"{'' if kind == '1288' else '.'}{kind}{'' if part == 'total' else f'.{part}'}"
            out.add(f"dsnu_{name}_e", f"DSNU{symbol}", "e-", section + when, dsnu)
            out.add(f"prnu_{name}_percent", f"PRNU{symbol}", "%", section, prnu)
            if name == "1288":
                values = {"dsnu": dsnu.value or 0.0, "prnu": prnu.value or 0.0}
    return values["dsnu"], values["prnu"], shown


def _shown(what: str, image: Image, filtered: np.ndarray) -> dict[str, np.ndarray]:
    counts, edges = patterns.histogram(filtered, image.level.count)
    deviation, percent = patterns.accumulated(filtered)
    return {f"{what}_spectrum_rows_dn": patterns.spectrogram(filtered),
            f"{what}_spectrum_columns_dn": patterns.spectrogram(filtered.T),
            f"{what}_temporal_dn": np.array([np.sqrt(spatial.NOISE_GAIN * image.temporal_dn2)]),
            f"{what}_profile_rows_dn": image.base_dn + patterns.profiles(image.above_dn),
            f"{what}_profile_columns_dn": image.base_dn + patterns.profiles(image.above_dn.T),
            f"{what}_histogram_count": counts, f"{what}_histogram_edge_dn": edges,
            f"{what}_accumulated_dn": deviation, f"{what}_accumulated_percent": percent}


def _dark_curve(darks: Darks) -> dict[str, np.ndarray]:
    return {"dark_exposure_s": darks.exposure_s, "dark_mean_dn": darks.mean_dn, "dark_variance_dn2": darks.variance_dn2}


def _root(part: spatial.Spatial, unit: str) -> Figure:
    note = "" if part.signed_variance >= 0 else spatial.NEGATIVE.format(part.signed_variance, unit)
    return Figure(part.sd, part.uncertainty, note)


def _product(figure: Figure, factor: Figure) -> Figure:
    """The DN figure that a figure in e- came from: the gain's error is taken out again."""
    if figure.value is None:
        return figure
    own = figure.error**2 - (figure.value * factor.error / factor.value) ** 2
    return Figure(figure.value * factor.value, float(np.sqrt(max(own, 0.0))) * factor.value, figure.reason)
