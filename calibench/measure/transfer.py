"""Photon transfer: everything that an EMVA 1288 release 4 Linear datasheet holds, from a ladder of light and its darks.

1. Frames stream into levels (alike in kind, exposure and light); a level is reduced to a few sums (`_photon/levels.py`).
2. Each plane of a mosaic apart: the curve of mean and temporal variance above dark, its saturation (`_photon/curve.py`).
3. Gain, quantum efficiency, noise, threshold, linearity, dark current (`_photon/parameters.py`).
4. Nonuniformity of the dark and of the lit stack, raw and high-passed, split into rows, columns, pixels (`_photon/plane.py`).
5. A correction of the response's bend, where held-out levels show that it helps (`_photon/linearity.py`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from ..records import CalibrationMap, Frame, Measurement, Quantity
from ._dark.darkness import check_dark, high_level
from ._dark.limits import MAX_EXPOSURE_S
from ._frames.ledger import Ledger
from ._frames.stack import mean_image
from ._photon.crosstalk import STEPS
from ._photon.curve import FITTED_FILL, Curve, Darks, darks_of
from ._photon.levels import Level, Levels
from ._photon.linearity import correction
from ._photon.plane import Image, Plane, analyse

MEND = "take a ladder of about 50 (at least 9) even steps from dark to saturation, two frames each, and darks of each exposure"
APART = ("Frames of one exposure whose means differ by more than 1 % are different levels, unless the photons of each are "
         "stated: a light that flickers looks like that")
FEW_LEVELS = 9
DARK_STEPS = 4.0
FLICKER, DIM = 0.002, 0.05  # relative scatter of the frames of a level, at this part of saturation and above
MAX_FLICKER = 0.03  # rms over the levels: beyond it saturation, linearity and responsivity are the lamp's
MOST_SINGLE = 1 / 3  # of the light's frames
CORRELATED, CORRELATED_SIGMA = 0.01, 5.0
GAINS = ("gain_crosstalk_corrected_dn_per_e", "gain_dn_per_e")  # the first that is known goes into the map


@dataclass(frozen=True, kw_only=True)
class Settings:
    """irradiance_photons_per_px_s: photons a pixel receives each second at every light level, where the lamp is constant and
    known; 0: not known, then no quantum efficiency. lens: was a lens mounted, "yes", "no" or "" (not stated): with one, the
    figures are those of the system, its shading included.
    """

    irradiance_photons_per_px_s: float = 0.0
    lens: str = ""


def measure(frames: Iterable[Frame], settings: Settings | None = None, calmap: CalibrationMap | None = None) -> Measurement:
    """All figures of a photon transfer series; darks (kind 'dark') among the frames, else the map's dark layers serve.

    Raises:
        BadInput: no light or no darks, mixed settings, one frame a level, too few levels, a light that flickers,
            swapped darks, absurd exposures.
    """
    settings = settings or Settings()
    if settings.lens not in ("yes", "no", ""):
        raise BadInput(f"lens is '{settings.lens}'", mend="say yes or no, or leave it out")
    ledger = Ledger(settings, "transfer frames")
    gathered = _gather(frames, ledger, settings)
    first = ledger.first
    planes: dict[str, Plane] = {}
    for i, (name, levels) in enumerate(gathered.levels.items()):
        lit, darks = [v for v in levels if not v.dark], _darks(levels, calmap, first, i)
        if not lit:
            raise BadInput("no level of light has two frames", mend=MEND)
        _refuse_swapped(lit, [v for v in levels if v.dark])
        dark, bright = (_image(gathered, i, is_dark) for is_dark in (True, False))
        planes[name] = analyse(lit, darks, dark, bright, first.white_level_dn)
    curves = [plane.curve for plane in planes.values()]
    _refuse_flicker(curves)
    quantities = _all_planes(planes)
    gains = {q.name: q.value for q in quantities if q.name in GAINS}
    layers = {"gain_dn_per_e": next(gains[name] for name in GAINS if gains[name])}
    if all(c.saturation is not None for c in curves):
        layers["saturation_dn"] = min(_saturation_dn(c) for c in curves)
    linear = correction(curves)
    if linear is not None:
        layers["linearity_dn"] = linear
    evidence = {f"{key}_{name}" if name else key: value for name, plane in planes.items()
                for key, value in plane.evidence.items()}
    return Measurement(
        name="transfer", image_size_px=first.image_size_px, quantities=quantities, layers=layers, evidence=evidence,
        provenance=ledger.provenance(), warnings=_warnings(ledger, planes, settings, linear),
        frames_used=sum(v.count for v in next(iter(gathered.levels.values()))), frames_rejected=tuple(ledger.rejected))


def _gather(frames: Iterable[Frame], ledger: Ledger, settings: Settings) -> Levels:
    gathered = None
    checked_s = -1.0
    for frame in frames:
        if frame.exposure_s is not None and frame.exposure_s > MAX_EXPOSURE_S:
            raise BadInput(f"an exposure of {frame.exposure_s:g} s is longer than a day", file=frame.file or None,
                           mend="give exposures in seconds (in nanoseconds in a descriptor)")
        if frame.kind == "dark" and (frame.exposure_s or 0.0) > DARK_STEPS * checked_s:  # some: the check is slow
            check_dark(frame)
            checked_s = frame.exposure_s or 0.0
        if not ledger.take(frame):
            if not _featureless(frame):
                continue
            ledger.rejected.pop()  # full or empty throughout: alike without being copies
        photons = frame.photons_per_px
        if photons is None and settings.irradiance_photons_per_px_s > 0 and frame.exposure_s is not None:
            photons = settings.irradiance_photons_per_px_s * frame.exposure_s
        gathered = gathered or Levels(frame.bayer_pattern)
        gathered.add(frame, photons)
    if gathered is None:
        raise BadInput("no frames were given", mend=MEND)
    gathered.close(ledger.first.white_level_dn)
    ledger.rejected += [(file, "the only frame of its level: the temporal noise needs two") for file in gathered.single]
    if not any(gathered.levels.values()):
        raise BadInput(f"every level has one frame only: the temporal noise needs two frames of each. {APART}", mend=MEND)
    _refuse_scattered(gathered)
    return gathered


def _refuse_scattered(gathered: Levels) -> None:
    lit = sum(v.count for v in next(iter(gathered.levels.values())) if not v.dark)
    alone = gathered.single_lit
    if alone > MOST_SINGLE * (lit + alone):
        raise BadInput(f"{alone} of {lit + alone} frames of light are the only one of their level. {APART}", mend=MEND)


def _refuse_flicker(curves: list[Curve]) -> None:
    """The gain stands a flickering lamp; what follows from the light of a level does not."""
    rms = max(float(np.sqrt(np.mean(c.flicker[c.below(1.0, DIM)] ** 2))) for c in curves)
    if rms > MAX_FLICKER:
        raise BadInput(f"the light flickers: frames of one level differ by {100 * rms:.2g} % (1 sigma)",
                       mend="feed the lamp from a steady supply, expose for whole periods of the mains, let it warm up")


def _featureless(frame: Frame) -> bool:
    return bool(np.all(frame.data[0] == frame.data[0, 0]) and np.all(frame.data == frame.data[0, 0]))


def _darks(levels: list[Level], calmap: CalibrationMap | None, first: Frame, plane: int) -> Darks:
    dark = [v for v in levels if v.dark]
    if dark:
        return darks_of(dark)
    if calmap is None or not {"offset_dn", "read_noise_dn"} <= calmap.measured:
        raise BadInput("no darks of two frames are among the frames, and no map with offset and read noise was given",
                       mend="add darks of each exposure, two frames each, or give --map")
    if calmap.image_size_px != first.image_size_px:
        raise BadInput(f"the map is of {calmap.image_size_px} px, the frames of {first.image_size_px} px")
    place = np.s_[:, :] if first.bayer_pattern is None else np.s_[plane // 2::2, plane % 2::2]
    offset, rate, noise = (float(np.mean(getattr(calmap, n)[place].astype(float) ** p)) for n, p in (
        ("offset_dn", 1), ("dark_rate_dn_per_s", 1), ("read_noise_dn", 2)))
    t = np.array([0.0, 1.0])
    return Darks(exposure_s=t, correlation=np.zeros(len(STEPS)),
                 mean_dn=offset + rate * t, mean_error_dn=np.full(2, 1e-9), variance_dn2=np.full(2, noise),
                 variance_error_dn2=np.full(2, noise * np.sqrt(2 / calmap.read_noise_dn[place].size)))


def _refuse_swapped(lit: list[Level], dark: list[Level]) -> None:
    brightest = {v.exposure_s: v.mean_dn for v in sorted(lit, key=lambda v: v.mean_dn)}
    wrong = [v for v in dark if v.mean_dn > brightest.get(v.exposure_s, np.inf) + 3 * np.sqrt(v.variance_dn2)]
    if wrong:
        at = "" if wrong[0].exposure_s is None else f" at {wrong[0].exposure_s:g} s"
        raise BadInput(f"the darks are brighter ({wrong[0].mean_dn:.0f} DN) than the light "
                       f"({brightest[wrong[0].exposure_s]:.0f} DN){at}", mend="were the folders of darks and light swapped?")


def _image(gathered: Levels, plane: int, dark: bool) -> Image | None:
    stack = gathered.stacks.get(dark)
    if stack is None:
        return None
    level = stack.levels[plane]
    base_dn = round(level.mean_dn)
    above = stack.totals[plane].astype(np.int32)
    above -= base_dn * level.count
    return Image(base_dn=base_dn, above_dn=mean_image(above, level.count), level=level)


def _all_planes(planes: dict[str, Plane]) -> tuple[Quantity, ...]:
    """Of a mosaic: each plane's figures under its name, and their mean without one."""
    if list(planes) == [""]:
        return planes[""].quantities
    out = []
    for same in zip(*(plane.quantities for plane in planes.values()), strict=True):
        one = same[0]
        missing = next((q for q in same if q.value is None), None)
        mean = None if missing else float(np.mean([q.value for q in same]))
        error = None if missing else float(np.linalg.norm([q.uncertainty for q in same]) / len(same))
        out.append(dataclasses.replace(one, value=mean, uncertainty=error, source=f"{one.source}; mean over the colour planes",
                                       reason=(missing or one).reason))
        out += [dataclasses.replace(q, name=f"{q.name}_{name}") for name, q in zip(planes, same, strict=True)]
    return tuple(out)


def _saturation_dn(curve: Curve) -> float:
    """DN at and above which a pixel of a frame counts as full: the largest value, or where the variance falls."""
    return curve.top_dn if curve.saturated_by.startswith("last") else float(curve.mean_dn[curve.saturation])


def _correlated(which: str, plane: Plane) -> list[str]:
    """What correlated noise does to the gain, between pixels and between frames."""
    out = []
    if plane.crosstalk.gain.value:
        right, lower = (f"{figure.value:+.3f}" for figure in plane.crosstalk.correlation)
        low = 100 * (1 - plane.gain.value / plane.crosstalk.gain.value)
        out.append(f"{which}the photon noise of neighbouring pixels is correlated (right {right}, lower {lower}): crosstalk, "
                   f"or processed frames. The standard's gain is low by {low:.1f} %, QE and noises in e- are high by as much; "
                   "the map takes gain_crosstalk_corrected_dn_per_e")
    late = plane.lag
    if late.value is not None and abs(late.value) > max(CORRELATED, CORRELATED_SIGMA * late.error):
        out.append(f"{which}the noise of consecutive frames is correlated by {late.value:+.3f} (image lag?): the gain from "
                   f"pairs is off by about {-300 * late.value:.1f} %")
    return out


def _warnings(ledger: Ledger, planes: dict[str, Plane], settings: Settings, linear: np.ndarray | None) -> tuple[str, ...]:
    first, out = ledger.first, list(ledger.warnings)
    curve = next(iter(planes.values())).curve
    if first.bit_depth <= 8:
        out.append("8-bit frames: quantisation hides the dark noise and bends the dim end of the curve")
    out += high_level(float(next(iter(planes.values())).evidence["dark_mean_dn"].max()), first.white_level_dn)
    if curve.fitted.sum() < FEW_LEVELS:
        out.append(f"{curve.fitted.sum()} levels up to 70 % of saturation: the standard wants {FEW_LEVELS} at least")
    if curve.saturation is None:
        out.append("saturation was not reached: saturation capacity, SNR max and dynamic range are left out")
    if not curve.own_dark:
        out.append("not every light level has darks of its own exposure: the dark below is common or interpolated")
    worst = max(float(np.max(c.flicker[c.below(FITTED_FILL, DIM)], initial=0.0)) for c in (p.curve for p in planes.values()))
    if worst > FLICKER:
        out.append(f"frames of one level differ by up to {100 * worst:.2g} % (1 sigma): the lamp flickers or drifts; taken "
                   "off the temporal noise, as the standard has it")
    for name, plane in planes.items():
        which = f"plane {name}: " if name else ""
        if plane.gain.reason:
            out.append(f"{which}gain: {plane.gain.reason}")
        out += _correlated(which, plane)
    if linear is not None:
        out.append("the response bends: a correction of it goes into the map")
    lens = {"yes": "a lens was mounted: figures of the whole system, its shading included", "no": ""}.get(
        settings.lens, "whether a lens was mounted is not stated: without one the figures are the sensor's")
    return tuple(out + [lens] * bool(lens))
