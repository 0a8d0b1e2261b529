"""PsfMap: the point spread function as a smooth function of the place on the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import frozen, settle

CENTRE_OF_MASS = "centre of mass of the light"


@dataclass(frozen=True, kw_only=True)
class HermiteShape:
    """The PSF as a Gauss-Hermite series whose coefficients are polynomials over the field (formulas: spots/hermite).

    order: of the core, whose Gaussian has scale_px. degree: over the field. coefficients (functions, terms): rows in the order
    of `spots.hermite.free_functions`, terms as in PsfMap. radius_px: of the windows that were fitted; beyond it the series is
    a continuation. core_residual: rms misfit where the light is, as a share of the peak. dither_coverage: share of the pixel
    (in 4 x 4 parts) in which some spot was centred.
    """

    order: int
    degree: int
    scale_px: float
    coefficients: np.ndarray
    radius_px: int
    core_residual: float
    dither_coverage: float

    def __post_init__(self) -> None:
        terms = (self.degree + 1) * (self.degree + 2) // 2
        settle(self, coefficients=frozen(np.ascontiguousarray(self.coefficients, dtype=float),
                                         name="HermiteShape.coefficients", shape=(None, terms)))


@dataclass(frozen=True, kw_only=True)
class PsfMap:
    """Coefficients of the PSF over the field.

    model: "gaussian": three rows, second moments (s_xx, s_yy, s_xy) in px^2 of the light before the pixel integrates it.
    "gauss_hermite": these are the moments of the nearest Gaussian, and `hermite` holds the shape itself.
    coefficients: (rows, terms), polynomial in (u, v), the pixel position scaled to [-1, 1] over the image, terms ordered
    by total degree then by power of v: 1, u, v, u^2, uv, v^2, ...
    centre: what point of the spot a centroid through this map means.
    measured_xy_px: (N, 2) where spots were measured. residual_rms_px2: scatter of the moments about the polynomial.
    """

    model: str
    degree: int
    coefficients: np.ndarray
    image_size_px: tuple[int, int]
    centre: str
    measured_xy_px: np.ndarray
    residual_rms_px2: float
    hermite: HermiteShape | None = None

    def __post_init__(self) -> None:
        terms = (self.degree + 1) * (self.degree + 2) // 2
        settle(self,
               coefficients=frozen(self.coefficients, name="PsfMap.coefficients", shape=(None, terms), dtype=float),
               measured_xy_px=frozen(self.measured_xy_px, name="PsfMap.measured_xy_px", shape=(None, 2), dtype=float))

    @classmethod
    def unknown(cls, image_size_px: tuple[int, int], sigma_px: float = 1.0) -> PsfMap:
        """A round Gaussian everywhere: the identity layer of a map whose PSF was not measured."""
        return cls(model="gaussian", degree=0, coefficients=np.array([[sigma_px**2], [sigma_px**2], [0.0]]),
                   image_size_px=image_size_px, centre="centre of a round Gaussian", measured_xy_px=np.zeros((0, 2)),
                   residual_rms_px2=np.inf)
