"""A lab session of a simulated camera, frame by frame with its truth: boards/, darks/, flats/, spots/, sky/, transfer/."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..geometry.sphere import camera_pointing_at
from ..records import Frame, Observer, StarTable
from .board import Board, random_poses, render_board
from .camera import SimulatedCamera, stream
from .ladder import LightLadder
from .lamp import lit_flat
from .pinholes import pinholes
from .sensor import expose
from .starfield import SkyConditions, star_field
from .truth import board_truth, flat_truth, ladder_truth, sky_truth, spots_truth

# Each kind of frame draws from random streams of its own, so that changing one count changes no other frame.
_BOARD_POSES, _BOARDS, _DARKS, _FLATS, _SPOTS, _SKY, _LADDER, _LADDER_DARKS = range(8)


@dataclass(frozen=True, kw_only=True)
class SkyPointing:
    """Where the boresight looks (ICRS, deg; roll: position angle of image up, east of north) and when (ISO 8601, UTC).
    field: the name of the place, for the file's name."""

    field: str
    ra_deg: float
    dec_deg: float
    roll_deg: float
    date_obs: str


@dataclass(frozen=True, kw_only=True)
class SessionPlan:
    """What a session holds. darks and flats: pairs of (exposure_s, frames); white_e and lamp_e_per_s: photo-electrons where the
    lens is brightest; spot_flux_e: of one pinhole on the axis; ladder: a photon transfer series."""

    board: Board
    board_views: int
    board_exposure_s: float
    board_white_e: float
    darks: tuple[tuple[float, int], ...]
    flats: tuple[tuple[float, int], ...]
    lamp_e_per_s: float
    spot_frames: int
    spot_grid: tuple[int, int]
    spot_exposure_s: float
    spot_flux_e: float
    sky: tuple[SkyPointing, ...]
    sky_exposure_s: float
    sky_conditions: SkyConditions
    temperature_c: float
    ladder: LightLadder | None = None


@dataclass(frozen=True, kw_only=True)
class RenderedFrame:
    """path: where the frame belongs inside the session's folder; truth: plain dict of what is true of it."""

    path: str
    frame: Frame
    truth: dict


def render_session(camera: SimulatedCamera, stars: StarTable, plan: SessionPlan, *, seed: int,
                   observer_at: Callable[[str], Observer], suffix: str = ".png") -> Iterator[RenderedFrame]:
    """Render the plan's frames one after the other; the caller writes them. observer_at: ISO date -> Observer.

    The same camera, plan and seed give the same frames, bit for bit.
    """
    def taken(path: str, light_e: np.ndarray | float, truth: dict, *, kind: str, exposure_s: float,
              rng: np.random.Generator, date_obs: str | None = None) -> RenderedFrame:
        data = expose(camera, light_e, exposure_s=exposure_s, temperature_c=plan.temperature_c, rng=rng)
        frame = Frame(data=data, kind=kind, bit_depth=camera.sensor.bit_depth, white_level_dn=camera.sensor.white_level_dn,
                      exposure_s=exposure_s, gain_setting=camera.gain_setting, temperature_c=plan.temperature_c,
                      pixel_size_um=camera.pixel_size_um, date_obs=date_obs, camera=camera.name, file=path + suffix)
        return RenderedFrame(path=path + suffix, frame=frame, truth=truth)

    poses = random_poses(camera, plan.board, plan.board_views, stream(seed, _BOARD_POSES))
    for i, pose in enumerate(poses):
        light_e = render_board(camera, plan.board, pose, white_e=plan.board_white_e)
        yield taken(f"boards/board_{i + 1:02d}", light_e, board_truth(camera, plan.board, pose), kind="light",
                    exposure_s=plan.board_exposure_s, rng=stream(seed, _BOARDS, i))

    for level, (exposure_s, count) in enumerate(plan.darks):
        for i in range(count):
            yield taken(f"darks/dark_{1e3 * exposure_s:g}ms_{i + 1:02d}", 0.0, {"scene": "dark"}, kind="dark",
                        exposure_s=exposure_s, rng=stream(seed, _DARKS, level, i))

    for level, (exposure_s, count) in enumerate(plan.flats):
        peak_e = plan.lamp_e_per_s * exposure_s
        light_e = lit_flat(camera, peak_e=peak_e)
        for i in range(count):
            yield taken(f"flats/flat_{1e3 * exposure_s:g}ms_{i + 1:02d}", light_e, flat_truth(peak_e), kind="flat",
                        exposure_s=exposure_s, rng=stream(seed, _FLATS, level, i))

    for i in range(plan.spot_frames):
        rng = stream(seed, _SPOTS, i)
        image = pinholes(camera, columns=plan.spot_grid[0], rows=plan.spot_grid[1], flux_e=plan.spot_flux_e, rng=rng)
        yield taken(f"spots/spots_{i + 1:02d}", image.light_e, spots_truth(image), kind="light",
                    exposure_s=plan.spot_exposure_s, rng=rng)

    for i, pointing in enumerate(plan.sky):
        rng = stream(seed, _SKY, i)
        observer = observer_at(pointing.date_obs)
        r_cam_icrs = camera_pointing_at(*np.radians([pointing.ra_deg, pointing.dec_deg, pointing.roll_deg]))
        field = star_field(camera, stars, r_cam_icrs, exposure_s=plan.sky_exposure_s, conditions=plan.sky_conditions,
                           observer=observer, rng=rng)
        yield taken(f"sky/sky_{i + 1:02d}_{pointing.field}", field.light_e,
                    sky_truth(camera, stars, field, r_cam_icrs, observer), kind="light", exposure_s=plan.sky_exposure_s,
                    rng=rng, date_obs=pointing.date_obs)

    for kind, folder, key in (("flat", "transfer", _LADDER), ("dark", "transfer_darks", _LADDER_DARKS)):
        for level, (exposure_s, count) in enumerate(plan.ladder.shots if plan.ladder else ()):
            photons = plan.ladder.photons_per_px_s * exposure_s if kind == "flat" else 0.0
            light_e = photons * camera.sensor.quantum_efficiency
            for i in range(count):
                path = f"{folder}/{kind}_{1e3 * exposure_s:07.3f}ms_{i + 1:03d}"
                yield taken(path, light_e, ladder_truth(photons), kind=kind, exposure_s=exposure_s,
                            rng=stream(seed, key, level, i))


_SAMPLE_SKY = (
    SkyPointing(field="orion", ra_deg=84.0, dec_deg=-1.0, roll_deg=8.0, date_obs="2025-01-18T20:14:00"),
    SkyPointing(field="cygnus", ra_deg=306.0, dec_deg=40.0, roll_deg=-57.0, date_obs="2025-08-02T22:40:00"),
    SkyPointing(field="dipper", ra_deg=181.0, dec_deg=56.0, roll_deg=131.0, date_obs="2025-04-11T21:05:00"),
    SkyPointing(field="scorpius", ra_deg=252.0, dec_deg=-33.0, roll_deg=-160.0, date_obs="2025-06-21T23:30:00"),
)


def sample_plan() -> SessionPlan:
    """The small session that is shipped with the project: complete, and below 15 MB as 16-bit PNG."""
    return SessionPlan(
        board=Board(columns=9, rows=6, square_mm=25.0), board_views=16, board_exposure_s=0.01, board_white_e=3000.0,
        darks=((0.0001, 4), (0.1, 3), (0.2, 3), (0.5, 3), (1.0, 4)), flats=((0.02, 6),), lamp_e_per_s=225e3,
        spot_frames=4, spot_grid=(15, 10), spot_exposure_s=0.02, spot_flux_e=8000.0,
        sky=_SAMPLE_SKY, sky_exposure_s=0.2, sky_conditions=SkyConditions(false_stars=2, cosmic_hits=3), temperature_c=25.0)


def thesis_plan() -> SessionPlan:
    """A session of the size that the thesis took: 30 boards, darks of 20 frames at its three exposures and at longer ones (its
    sensor's hot pixels only), 30 + 30 flats, 12 spot frames, the sample's sky."""
    return SessionPlan(
        board=Board(columns=9, rows=6, square_mm=25.0), board_views=30, board_exposure_s=0.01, board_white_e=4500.0,
        darks=tuple((t, 20) for t in (0.0001, 0.0243, 0.0486, 0.0729, 0.2, 1.0)), flats=((0.012, 30), (0.02, 30)),
        lamp_e_per_s=225e3, spot_frames=12, spot_grid=(15, 10), spot_exposure_s=0.02, spot_flux_e=8000.0,
        sky=_SAMPLE_SKY, sky_exposure_s=0.2, sky_conditions=SkyConditions(false_stars=2, cosmic_hits=3), temperature_c=25.0)


def emva_plan() -> SessionPlan:
    """A photon transfer series and nothing else: 30 levels from dark to 5 % beyond the thesis camera's saturation, two frames
    each lit and dark, and stacks of 50 more at half of it."""
    exposures_s = tuple(np.linspace(0.001, 0.03, 30).round(7).tolist())
    return SessionPlan(
        board=Board(columns=9, rows=6, square_mm=25.0), board_views=0, board_exposure_s=0.01, board_white_e=0.0, darks=(),
        flats=(), lamp_e_per_s=0.0, spot_frames=0, spot_grid=(15, 10), spot_exposure_s=0.02, spot_flux_e=0.0, sky=(),
        sky_exposure_s=0.2, sky_conditions=SkyConditions(), temperature_c=25.0,
        ladder=LightLadder(exposures_s=exposures_s, photons_per_px_s=840e3, frames=2, stack_frames=50))
