"""Intrinsics: how directions in the camera become pixels, with the full covariance of its parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import BadInput
from .arrays import frozen, settle

# Distortion names by model, in OpenCV's order; the parameters before them are fx, fy, cx, cy. A fisheye's k are others than
# a Brown lens's: terms of one name mean the same only within a family (geometry/_rational.py, _fisheye.py).
DISTORTION_NAMES: dict[str, tuple[str, ...]] = {
    "pinhole": (),
    "brown4": ("k1", "k2", "p1", "p2"),
    "brown5": ("k1", "k2", "p1", "p2", "k3"),
    "rational8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "thin_prism12": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"),
    "fisheye4": ("k1", "k2", "k3", "k4"),
}


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """Lens model and camera matrix. Pixel (0, 0) is the centre of the top-left pixel.

    distortion: (n,) in OpenCV's order for `model` (see DISTORTION_NAMES).
    skew_px: change of the column over the focal length along y; None: the axes stand at right angles and it is no parameter.
    covariance: (P, P) of the parameters (fx, fy, cx, cy, distortion..., skew where it is one), random and systematic together;
    infinite where unknown.
    """

    model: str
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: np.ndarray
    image_size_px: tuple[int, int]
    covariance: np.ndarray
    mirrored: bool = False
    skew_px: float | None = None

    def __post_init__(self) -> None:
        if self.model not in DISTORTION_NAMES:
            raise BadInput(f"lens model '{self.model}' is none of {', '.join(DISTORTION_NAMES)}")
        n = len(DISTORTION_NAMES[self.model])
        p = 4 + n + (self.skew_px is not None)
        settle(self,
               distortion=frozen(self.distortion, name="Intrinsics.distortion", shape=(n,), dtype=float),
               covariance=frozen(self.covariance, name="Intrinsics.covariance", shape=(p, p), dtype=float),
               image_size_px=(int(self.image_size_px[0]), int(self.image_size_px[1])))
        if not (self.fx_px > 0 and self.fy_px > 0):
            raise BadInput(f"focal lengths must be positive, got fx {self.fx_px}, fy {self.fy_px}")

    @property
    def parameter_names(self) -> tuple[str, ...]:
        return ("fx_px", "fy_px", "cx_px", "cy_px", *DISTORTION_NAMES[self.model],
                *(() if self.skew_px is None else ("skew_px",)))

    @property
    def parameters(self) -> np.ndarray:
        """(P,) values in the order of `parameter_names`."""
        skew = () if self.skew_px is None else (self.skew_px,)
        return np.array([self.fx_px, self.fy_px, self.cx_px, self.cy_px, *self.distortion, *skew])

    def at(self, parameters: np.ndarray) -> Intrinsics:
        """The lens with other values (P,) of its parameters."""
        fx, fy, cx, cy, *rest = parameters.tolist()
        n = len(self.distortion)
        skew = {"skew_px": rest[n]} if self.skew_px is not None else {}
        return replace(self, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=np.array(rest[:n]), **skew)

    @property
    def is_fisheye(self) -> bool:
        """Whether the lens may see 90 degrees and more from its axis."""
        return self.model.startswith("fisheye")

    @property
    def camera_matrix(self) -> np.ndarray:
        """(3, 3) pinhole matrix in OpenCV's layout."""
        return np.array([[self.fx_px, self.skew_px or 0.0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1.0]])

    @classmethod
    def pinhole(cls, *, focal_px: float, image_size_px: tuple[int, int], focal_sd_px: float = np.inf) -> Intrinsics:
        """An ideal lens on the image's centre ((W-1)/2, (H-1)/2); focal_sd_px says how well it is known."""
        w, h = image_size_px
        covariance = np.diag([focal_sd_px**2, focal_sd_px**2, np.inf, np.inf])
        return cls(model="pinhole", fx_px=focal_px, fy_px=focal_px, cx_px=(w - 1) / 2, cy_px=(h - 1) / 2,
                   distortion=np.zeros(0), image_size_px=image_size_px, covariance=covariance)
