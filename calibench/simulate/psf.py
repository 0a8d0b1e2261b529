"""Point spread function of the simulated lens: sub-pixel, pixel-integrated, astigmatic and comatic off the axis.

Centre convention: a source's true position, the pixel that `geometry.projection.project` gives for its direction, is the centre
of mass of its light (docs/conventions.md), and the camera's lens is the one of these centres. Astigmatism and field curvature
are symmetric about the chief ray; coma draws a flare outward along the field radius, so that the chief ray lies
`coma_px * field` inside the centre of mass (field = 1 at the image corner). Boards are seen through the same PSF (`board`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadInput
from .pupil import Pupil, coma_shift_px
from .pupil import stamps as pupil_stamps

# The comatic figure as three Gaussians along the field radius: weight, offset from the chief ray and extra sigma, these two in
# units of the flare's length.
_FLARE = np.array([[0.70, 0.0, 0.0], [0.22, 1.0, 0.35], [0.08, 2.25, 0.80]])
_MEAN_OFFSET = float(_FLARE[:, 0] @ _FLARE[:, 1])
_HALF_WINDOW_PX = 9
_PIXEL_VARIANCE_PX2 = 1 / 12


@dataclass(frozen=True, kw_only=True)
class Aberrations:
    """The lens's PSF over the field, third order: coma grows with the field, astigmatism and field curvature with its square.

    core_sigma_px: Gaussian sigma on the axis, before the pixel integrates. radial_blur_px, tangential_blur_px: sigma that
    astigmatism and field curvature add in quadrature at the corner. coma_px: the centroid's way outward of the chief ray there.
    centre_px: the optical axis; corner_radius_px: its field radius 1.
    """

    core_sigma_px: float
    radial_blur_px: float
    tangential_blur_px: float
    coma_px: float
    centre_px: tuple[float, float]
    corner_radius_px: float


def _field(aberrations: Aberrations | Pupil, xy_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Field radius (N,) and outward unit vector (N, 2); on the axis itself every direction is as good."""
    offset = (np.asarray(xy_px, float).reshape(-1, 2) - aberrations.centre_px) / aberrations.corner_radius_px
    field = np.hypot(offset[:, 0], offset[:, 1])
    outward = np.where(field[:, None] > 0, offset / np.where(field > 0, field, 1.0)[:, None], [1.0, 0.0])
    return field, outward


def chief_ray_px(aberrations: Aberrations | Pupil, xy_px: np.ndarray) -> np.ndarray:
    """Chief rays (N, 2) of sources whose light has its centre of mass at xy_px (N, 2)."""
    field, outward = _field(aberrations, xy_px)
    shift_px = coma_shift_px(aberrations, field) if isinstance(aberrations, Pupil) else aberrations.coma_px * field
    return np.asarray(xy_px, float).reshape(-1, 2) - shift_px[:, None] * outward


@dataclass(frozen=True, kw_only=True)
class Flare:
    """The PSF at N places as a sum of Gaussians, before the pixel: weight (3,); offset_px outward of the centre of mass,
    radial_px2 and tangential_px2 variance (3, N); outward (N, 2) unit vector."""

    weight: np.ndarray
    offset_px: np.ndarray
    radial_px2: np.ndarray
    tangential_px2: np.ndarray
    outward: np.ndarray


def flare(aberrations: Aberrations, xy_px: np.ndarray) -> Flare:
    """The PSF about each of the centres of mass xy_px (N, 2)."""
    field, outward = _field(aberrations, xy_px)
    length_px = aberrations.coma_px * field / _MEAN_OFFSET
    common = aberrations.core_sigma_px**2 + (_FLARE[:, 2:] * length_px) ** 2
    return Flare(weight=_FLARE[:, 0], offset_px=(_FLARE[:, 1:2] - _MEAN_OFFSET) * length_px, outward=outward,
                 radial_px2=common + (aberrations.radial_blur_px * field**2) ** 2,
                 tangential_px2=common + (aberrations.tangential_blur_px * field**2) ** 2)


def moments_px2(aberrations: Aberrations, xy_px: np.ndarray) -> np.ndarray:
    """Second central moments (N, 3) s_xx, s_yy, s_xy of the pixel-integrated PSF at xy_px (N, 2), px^2."""
    parts = flare(aberrations, xy_px)
    radial, tangential = parts.weight @ (parts.radial_px2 + parts.offset_px**2), parts.weight @ parts.tangential_px2
    cos, sin = parts.outward.T
    return np.column_stack([radial * cos**2 + tangential * sin**2 + _PIXEL_VARIANCE_PX2,
                            radial * sin**2 + tangential * cos**2 + _PIXEL_VARIANCE_PX2,
                            (radial - tangential) * cos * sin])


def render_sources(aberrations: Aberrations | Pupil, xy_px: np.ndarray, flux_e: np.ndarray, image_size_px: tuple[int, int], *,
                   pinhole_px: float = 0.0) -> np.ndarray:
    """Image (H, W) of expected electrons of point sources: centres of mass xy_px (N, 2), fluxes flux_e (N,).

    What falls off the image is lost; the window of 19 pixels holds all but 2e-6 of a flux (of a pupil's, with its diffraction
    wings, all but 1 %). pinhole_px: diameter of the sources' own image; only a Pupil can render it.

    Raises:
        BadInput: a pinhole of some size through Aberrations.
    """
    width, height = image_size_px
    xy_px = np.asarray(xy_px, float).reshape(-1, 2)
    nearest = np.rint(xy_px).astype(int)
    window = np.arange(-_HALF_WINDOW_PX, _HALF_WINDOW_PX + 1)
    columns, rows = nearest[:, 0, None, None] + window, nearest[:, 1, None, None] + window[:, None]
    dx, dy = columns - xy_px[:, 0, None, None], rows - xy_px[:, 1, None, None]
    if isinstance(aberrations, Pupil):
        stamps = pupil_stamps(aberrations, *_field(aberrations, xy_px), dx[:, 0], dy[:, :, 0], pinhole_px=pinhole_px)
    elif pinhole_px:
        raise BadInput("Aberrations render points only", mend="give the camera a Pupil")
    else:
        stamps = _flare_stamps(flare(aberrations, xy_px), dx, dy)
    stamps *= np.asarray(flux_e, float)[:, None, None]

    columns, rows = (np.broadcast_to(a, stamps.shape) for a in (columns, rows))
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    flat = np.bincount(rows[inside] * width + columns[inside], weights=stamps[inside], minlength=width * height)
    return flat.astype(float).reshape(height, width)  # of no source at all bincount makes integers


def _flare_stamps(parts: Flare, dx: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """Share of the light (N, R, C) in each pixel at dx (N, 1, C), dy (N, R, 1) from the centre of mass.

    Each pixel integrates the PSF over its square by 4 x 4 Gauss-Legendre nodes (error below 2e-5 of the peak for sigma 0.5 px).
    """
    cos, sin = (a[:, None, None] for a in parts.outward.T)
    nodes, node_weights = np.polynomial.legendre.leggauss(4)
    stamps = np.zeros(np.broadcast_shapes(dx.shape, dy.shape))
    for weight, *figures in zip(parts.weight, parts.offset_px, parts.radial_px2, parts.tangential_px2, strict=True):
        shift, vr, vt = (a[:, None, None] for a in figures)
        peak = weight / (2 * np.pi * np.sqrt(vr * vt))
        for node_x, weight_x in zip(nodes / 2, node_weights / 2, strict=True):
            for node_y, weight_y in zip(nodes / 2, node_weights / 2, strict=True):
                r = (dx + node_x) * cos + (dy + node_y) * sin - shift
                t = (dy + node_y) * cos - (dx + node_x) * sin
                stamps += weight_x * weight_y * peak * np.exp(-0.5 * (r**2 / vr + t**2 / vt))
    return stamps
