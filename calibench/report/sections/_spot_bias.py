"""What a centroid does to a point's image: with its place in the pixel (S-curve), and with its flux (magnitude term)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ... import registry
from ...records import PsfMap
from ...spots.candidates import Candidates
from ...spots.psf import field_terms, light, moments_at
from ...spots.scene import FrameScene
from ..draw import BLUE, FAINT, GREY, ORANGE, WIDE, png, sheet
from ..numbers import percent
from ..section import Figure

METHODS = (("com", "centre of mass, 3×3", ORANGE), ("poisson", "Gaussian fit", GREY), ("psf_map", "fit of the map", BLUE))
HALF_PX = 12
NOISE_E = 10.0
BRIGHT_E, FAINT_E, FLUXES = 1e5, 1e3, 9
STEPS = 33
OUTER = 0.94  # of the way from the centre to the lower right corner


def bias_figure(psf: PsfMap) -> Figure:
    """S-curves at the centre and near a corner, and the drift with magnitude near the corner."""
    w, h = psf.image_size_px
    middle = np.array([w - 1, h - 1]) / 2
    made, (centre, corner, drift) = sheet(WIDE, 3)
    phase = np.column_stack([np.linspace(-0.5, 0.5, STEPS), np.zeros(STEPS)])
    swing = {}
    for axes, share, title in ((centre, 0.0, "in the centre"), (corner, OUTER, "near the corner")):
        for name, label, colour in METHODS:
            error = 1e3 * errors_px(psf, middle * (1 + share), phase, BRIGHT_E, name)[:, 0]
            axes.plot(phase[:, 0], error - error[:-1].mean(), color=colour, label=label)
            swing[name] = max(swing.get(name, 0.0), float(np.ptp(error)))
        axes.set(title=f"S-curve {title}", xlabel="place in the pixel, x (px)", ylabel="error of x (mpx)")
        axes.grid(color=FAINT)
    flux = np.geomspace(FAINT_E, BRIGHT_E, FLUXES)
    steps = np.linspace(-0.4, 0.4, 5)
    phases = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    drifts = {}
    for name, _, colour in METHODS[1:]:  # without a threshold and without noise the centre of mass knows no flux
        mean = np.array([errors_px(psf, middle * (1 + OUTER), phases, f, name).mean(0) for f in flux])
        along = 1e3 * (mean - mean[-1]) @ (middle / np.hypot(*middle))
        drift.plot(flux, along, color=colour)
        drifts[name] = float(along[0])
    drift.set(title="Drift with magnitude near the corner", xlabel="flux (e⁻)", ylabel="shift outward (mpx)", xscale="log")
    drift.grid(color=FAINT)
    centre.legend()
    rest = (f"The images are the map's own: what it does not know of the lens, {percent(psf.hermite.core_residual)} of the "
            "peak, comes on top." if psf.hermite is not None else "The map holds a Gaussian only: its fit is the Gaussian's.")
    return Figure(title="What centroids make of this PSF, before the map and with it", png=png(made), wide=True,
                  reading="From edge to edge of a pixel the centre of mass swings by {:.1f} mpx, the Gaussian fit by {:.1f}, "
                          "the map's by {:.1f}; from 1e5 to 1e3 e⁻ the fits drift by {:.1f} and {:.1f} mpx. "
                          .format(*(abs(v) for v in (*swing.values(), *drifts.values()))) + rest)


def errors_px(psf: PsfMap, xy_px: np.ndarray, phase_px: np.ndarray, flux_e: float, method: str) -> np.ndarray:
    """(N, 2) centroid less truth of noise-free images at one place of the field, centred at phases (N, 2) of a pixel.

    Each image stands in a tile of its own; NOISE_E a pixel sets thresholds and weights.
    """
    here = _constant(psf, xy_px)
    side, n = 2 * HALF_PX + 1, len(phase_px)
    offsets = np.arange(-HALF_PX, HALF_PX + 1)
    tiles = flux_e * np.concatenate([light(here, (0.0, 0.0), offsets - x, offsets - y) for x, y in phase_px])
    true = phase_px + np.column_stack([np.full(n, HALF_PX), HALF_PX + side * np.arange(n)])
    peak = np.array([np.unravel_index(tile.argmax(), tile.shape)[::-1] for tile in tiles.reshape(n, side, side)])
    peak = peak + np.column_stack([np.zeros(n, int), side * np.arange(n)])
    scene = FrameScene(signal_dn=tiles.astype(np.float32), floor_variance_dn2=np.full(tiles.shape, NOISE_E**2, np.float32),
                       unusable=np.zeros(tiles.shape, bool), gain_dn_per_e=1.0, psf=here, psf_known=True)
    candidates = Candidates(xy_px=true, peak_xy=peak, peak_dn=tiles[peak[:, 1], peak[:, 0]], flux_dn=np.full(n, flux_e),
                            pixels=np.full(n, 9), elongation=np.ones(n), blend=np.zeros(n, bool))
    return registry.load("calibench.spots.centroid", method).centroid(scene, candidates).xy_px - true


def _constant(psf: PsfMap, xy_px: np.ndarray) -> PsfMap:
    """The map as it is at one place, everywhere."""
    at = np.asarray(xy_px, float)[None]
    shape = psf.hermite and replace(psf.hermite, degree=0, coefficients=psf.hermite.coefficients @ field_terms(
        at, psf.image_size_px, psf.hermite.degree).T)
    return replace(psf, degree=0, coefficients=moments_at(psf, at).T, hermite=shape)
