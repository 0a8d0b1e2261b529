"""catalogue: a star table for one camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..errors import UsageError
from .output import Json, print_json, say, table

app = typer.Typer(no_args_is_help=True, help="Star tables for one camera.")
RAD_ARCSEC = 206264.80624709636


@app.command()
def build(out: Annotated[Path, typer.Option(help="File to write (.npz).")],
          limit_mag: Annotated[float, typer.Option(help="Faintest star, Hp.", min=-1, max=20)] = 7.0,
          map_: Annotated[Path | None, typer.Option("--map", help="The camera's map: its lens gives field and scale, its PSF "
                                                                  "what it parts.")] = None,
          fov_deg: Annotated[float | None, typer.Option(help="Horizontal field, degrees, without a map.", min=0.5,
                                                        max=120)] = None,
          width_px: Annotated[int | None, typer.Option(help="Image width, px, without a map.", min=16, max=200_000)] = None,
          double_px: Annotated[float | None, typer.Option(help="Stars nearer than this are one spot, px; else the map's FWHM, "
                                                               "or 2 px.", min=0, max=50)] = None,
          catalogue: Annotated[Path | None, typer.Option(help="Star table to start from; else the shipped one.")] = None,
          json_: Json = False) -> None:
    """A table for a camera: to its limiting magnitude, stars that its PSF does not part merged."""
    import math

    import numpy as np

    from ..io.map_file import read_map
    from ..io.star_table import SHIPPED, load_star_table, write_star_table
    from ..stars.camera_table import camera_table
    from ..stars.view import horizontal_fov
    calmap = read_map(map_) if map_ else None
    if calmap is not None and "intrinsics" in calmap.measured:
        field, width = horizontal_fov(calmap.intrinsics), calmap.image_size_px[0]
        scale = 1 / calmap.intrinsics.fx_px
    elif fov_deg and width_px:
        field, width = math.radians(fov_deg), width_px
        scale = 2 * math.tan(field / 2) / width
    else:
        raise UsageError("what one pixel sees is not known", mend="give a map with a lens (--map), or --fov-deg and --width-px")
    part_px = double_px if double_px is not None else _fwhm_px(calmap)
    made = camera_table(load_star_table(catalogue or SHIPPED), faintest_hp=limit_mag, part_rad=part_px * scale, field_rad=field)
    source = f"{made.table.source}; to Hp {limit_mag:g}, merged within {part_px:g} px of {scale * RAD_ARCSEC:.4g} arcsec"
    digest = write_star_table(out, replace(made.table, source=source))
    merged = [{"hip": list(m.hip), "shift_arcsec": m.shift_rad * RAD_ARCSEC, "hp_mag": m.hp_mag} for m in made.merged]
    values = {"catalogue": str(out), "sha256": digest, "stars": len(made.table), "limit_mag": limit_mag, "double_px": part_px,
              "double_arcsec": part_px * scale * RAD_ARCSEC, "fov_deg": math.degrees(field),
              "stars_in_view": {"least": int(made.stars_in_view.min()), "median": float(np.median(made.stars_in_view))},
              "poor_views": made.poor_views, "source": source, "merged": merged}
    if json_:
        print_json(values)
        return
    print(f"{out}: {len(made.table)} stars to Hp {limit_mag:g}; {len(made.merged)} spots of several stars within "
          f"{part_px:g} px ({values['double_arcsec']:.3g} arcsec) merged")
    print(f"round views of {values['fov_deg']:.4g} degrees: {values['stars_in_view']['least']} to "
          f"{int(made.stars_in_view.max())} stars, median {values['stars_in_view']['median']:.0f}")
    worst = sorted(made.merged, key=lambda m: -m.shift_rad)[:10]
    if worst:
        print(table(("merged HIP", "Hp", "moved arcsec"),
                    [(" + ".join(map(str, m.hip)), f"{m.hp_mag:.2f}", f"{m.shift_rad * RAD_ARCSEC:.2f}") for m in worst]))
    if made.poor_views > 0:
        say(f"{made.poor_views:.2%} of all boresights see fewer than 4 of these stars: take a fainter limit")


def _fwhm_px(calmap: object) -> float:
    """Width of the map's PSF at the image's centre, pixel included; 2 px where it is not known."""
    import numpy as np

    from ..spots.psf import FWHM_PER_SIGMA, moments_at
    if calmap is None or "psf" not in calmap.measured:
        return 2.0
    w, h = calmap.image_size_px
    sxx, syy, _ = moments_at(calmap.psf, np.array([[(w - 1) / 2, (h - 1) / 2]]))[0]
    return float(round(FWHM_PER_SIGMA * np.sqrt((sxx + syy) / 2 + 1 / 12), 2))
