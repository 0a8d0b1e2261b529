"""Results as plain JSON values, under the names that outside checks rely on. Degrees and arcseconds appear here only."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from ..records import DEFECT_FLAGS, DISTORTION_NAMES, SPOT_FLAGS, CalibrationMap, Measurement, Verdict

if TYPE_CHECKING:  # a measurement's result loads nothing of the sky
    from ..stars.solve import Solution
    from ..validate.case import Trial
    from ..validate.series_errors import SeriesErrors
    from .sky import SolvedFrame

ARCSEC = 180 * 3600 / math.pi
DEGREE = 180 / math.pi


def finite(value: float | None) -> float | None:
    """JSON has no NaN and no infinity: they become null."""
    return float(value) if value is not None and math.isfinite(value) else None


def measurement_json(measurement: Measurement) -> dict:
    """What every measuring command prints; `intrinsics` carries its lens besides."""
    out = {"measurement": measurement.name, "quantities": {q.name: q.as_json() for q in measurement.quantities},
           "frames_used": measurement.frames_used, "warnings": list(measurement.warnings),
           "frames_rejected": [{"file": file, "reason": reason} for file, reason in measurement.frames_rejected]}
    if "defects" in measurement.maps:
        flags = measurement.maps["defects"]
        out["defects"] = {name: int(np.count_nonzero(flags & bit)) for name, bit in DEFECT_FLAGS.items()}
    return out | (_lens_json(measurement) if measurement.intrinsics is not None else {})


def _lens_json(measurement: Measurement) -> dict:
    lens = measurement.intrinsics
    names = lens.parameter_names
    classical = measurement.evidence["uncertainty_classical"]
    values = {q.name: q.value for q in measurement.quantities}
    counts = {n: int(values[n]) for n in ("views_given", "views_used", "points", "outliers")}
    bow = [values[f"board_bow_{axis}_mm"] for axis in "xy"] if "board_bow_x_mm" in values else None
    return {"model": lens.model, "fx_px": lens.fx_px, "fy_px": lens.fy_px, "cx_px": lens.cx_px, "cy_px": lens.cy_px,
            "skew_px": lens.skew_px,
            "distortion": dict(zip(DISTORTION_NAMES[lens.model], lens.distortion.tolist(), strict=True)),
            "uncertainty": {n: finite(s) for n, s in zip(names, np.sqrt(np.diag(lens.covariance)), strict=True)},
            "uncertainty_classical": {n: finite(s) for n, s in zip(names, classical, strict=False)},
            "rms_px": values["rms_px"], "rms_all_px": values["rms_all_px"], "held_out_rms_px": values["held_out_rms_px"],
            "leave_one_out_rms_px": finite(values["leave_one_out_rms_px"]),
            "board_bow_mm": bow, "image_size_px": list(lens.image_size_px), "views": _views_json(measurement)} | counts


def _views_json(measurement: Measurement) -> list[dict]:
    """What each view used says of itself and means to the lens."""
    of, names = measurement.evidence, measurement.intrinsics.parameter_names
    rows = zip(measurement.provenance.settings["views"], of["view_rms_px"], of["view_left_out_rms_px"], of["view_effect_sd"],
               of["view_effect_by_parameter_sd"], strict=True)
    return [{"file": file, "rms_px": finite(rms), "left_out_rms_px": finite(left_out), "effect_sd": finite(effect),
             "effect_by_parameter_sd": {n: finite(e) for n, e in zip(names, by_parameter, strict=True)}}
            for file, rms, left_out, effect, by_parameter in rows]


def solved_json(solved: SolvedFrame, calmap: CalibrationMap | None, stars: tuple[np.ndarray, np.ndarray]) -> dict:
    """One entry of `solve`'s frames. stars: HIP numbers and magnitudes (Hp) by catalogue row."""
    solution = solved.solution
    out = {"file": solution.file, "status": solution.status, "reason": solution.attitude.reason or None}
    out |= pointing_json(solution)
    found = solution.identification
    hip, magnitude = stars
    out["stars"] = [{"x_px": float(x), "y_px": float(y), "hip": int(hip[row]), "magnitude": round(float(magnitude[row]), 3)}
                    for (x, y), row in zip(found.xy_px, found.star_rows, strict=True)]
    flags = {name: int(np.count_nonzero(solution.spots.flags & bit)) for name, bit in SPOT_FLAGS.items()}
    lens_known = calmap is not None and "intrinsics" in calmap.measured
    return out | {"map_outside_conditions": bool(solved.outside), "warnings": [*solved.outside, *solved.warnings],
                  "spot_flags": flags, "frame_notes": list(solved.frame.notes) if solved.frame else [],
                  "lens_from": "map" if lens_known else "fitted to this frame",
                  "time_utc": solved.observer.time_utc or None, "identified_by": found.method,
                  "timings_ms": {k: round(1e3 * v, 3) for k, v in solution.timings_s.items()}}


def pointing_json(solution: Solution) -> dict:
    """Attitude, pointing and errors of a solution; null where there is none."""
    good = solution.status == "solved"
    lens = solution.identification.intrinsics
    residual, bias = solution.attitude.residual_px, solution.systematic_covariance_rad2
    rms_px = float(np.sqrt(np.mean((residual**2).sum(1)))) if good else None
    values = {"ra_deg": solution.ra_rad * DEGREE, "dec_deg": solution.dec_rad * DEGREE,
              "roll_deg": solution.roll_rad * DEGREE % 360, "fov_deg": solution.fov_rad * DEGREE,
              "sigma_cross_arcsec": solution.sigma_cross_rad * ARCSEC, "sigma_roll_arcsec": solution.sigma_roll_rad * ARCSEC,
              "sigma_systematic_cross_arcsec": solution.systematic_centre_rad * ARCSEC,
              "sigma_systematic_boresight_arcsec": float(np.sqrt(np.trace(bias[:2, :2]) / 2)) * ARCSEC,
              "sigma_systematic_roll_arcsec": float(np.sqrt(bias[2, 2])) * ARCSEC}
    return {k: finite(v) for k, v in values.items()} | {
        "mirrored": lens.mirrored if good else None,
        "q_cam_icrs": solution.attitude.q_cam_icrs.tolist() if good else None,
        "matches": len(residual), "spots": len(solution.spots), "residual_rms_px": rms_px,
        "residual_rms_arcsec": rms_px / lens.fx_px * ARCSEC if good else None,
        "false_match_probability": solution.identification.false_match_probability}


def series_errors_json(errors: SeriesErrors) -> dict:
    """The split of a series' errors and the map of its mean residuals."""
    kinds = [{"name": kind.name, "star_px": kind.star_px, "reason": kind.reason or None,
              "cross_arcsec": None if kind.cross_rad is None else kind.cross_rad * ARCSEC,
              "roll_arcsec": None if kind.roll_rad is None else kind.roll_rad * ARCSEC} for kind in errors.kinds]
    cells = zip(errors.map_xy_px.tolist(), errors.map_residual_px.tolist(), errors.map_stars.tolist(), strict=True)
    return {"frames": errors.frames, "stars": errors.stars, "kinds": kinds,
            "residual_map": [{"x_px": x, "y_px": y, "dx_px": dx, "dy_px": dy, "stars": n} for (x, y), (dx, dy), n in cells]}


# What a series' CSV holds of each frame, in this order.
CSV_COLUMNS = ("file", "time_utc", "status", "ra_deg", "dec_deg", "roll_deg", "fov_deg", "mirrored", "q_cam_icrs",
               "sigma_cross_arcsec", "sigma_roll_arcsec", "sigma_systematic_cross_arcsec", "sigma_systematic_roll_arcsec",
               "matches", "spots", "residual_rms_px", "residual_rms_arcsec", "false_match_probability", "identified_by",
               "reason")


def verdict_json(verdict: Verdict) -> dict:
    """A verdict with its limit spelled out."""
    return asdict(verdict.limit) | {"status": verdict.status, "value": finite(verdict.value),
                                    "uncertainty": finite(verdict.uncertainty), "reason": verdict.reason}


def trial_json(trial: Trial) -> dict:
    """A trial's table as a list of rows by column name."""
    rows = [dict(zip(trial.columns, row, strict=True)) for row in trial.rows]
    return {"name": trial.name, "reading": trial.reading, "rows": rows}
