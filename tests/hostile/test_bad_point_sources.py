"""Spots that would spoil a PSF, by the command: rejected or flagged with a reason, and no map from too little."""

from __future__ import annotations

import json

import numpy as np
import pytest

from calibench.cli import main
from calibench.io.frame_writer import write_frame
from calibench.records import PsfMap
from calibench.spots.psf import light

SIZE = (260, 200)
ROUND, DRIFTING = (0.5, 0.5, 0.0), (1.1, 0.6, 0.4)


def grid(rng):
    x, y = np.meshgrid(np.linspace(25, 235, 6), np.linspace(25, 175, 5))
    return np.stack([x.ravel(), y.ravel()], -1) + rng.uniform(-0.5, 0.5, (30, 2))


def written(folder, scene, moments=ROUND, white=4095):
    """One frame of scene(rng) -> (x, y, flux), 12 bit, 0.1 DN/e-."""
    folder.mkdir()
    rng = np.random.default_rng(7)
    image = np.full(SIZE[::-1], 20.0)
    lens = PsfMap(model="gaussian", degree=0, coefficients=np.array(moments)[:, None], image_size_px=SIZE, centre="",
                  measured_xy_px=np.zeros((0, 2)), residual_rms_px2=0.0)
    for x, y, flux in scene(rng):
        column, row = round(x), round(y)
        columns, rows = (np.arange(max(at - 9, 0), min(at + 10, size)) for at, size in zip((column, row), SIZE, strict=True))
        image[np.ix_(rows, columns)] += flux * light(lens, (x, y), columns - x, rows - y)
    data = np.rint(50 + 0.1 * (rng.poisson(image) + rng.normal(0, 8, image.shape))).clip(0, white).astype(np.uint16)
    write_frame(folder / "0.png", data, kind="light", exposure_s=0.1, bit_depth=12, white_level_dn=white,
                egain_e_per_dn=10.0)
    return folder


def sound(rng, flux=3e4):
    return [(*xy, flux) for xy in grid(rng)]


@pytest.fixture()
def run(monkeypatch, capsys):
    """psf FOLDER --json -> exit code, JSON."""
    def call(folder, *options):
        monkeypatch.setattr("sys.argv", ["calibench", "psf", str(folder), "--json", *map(str, options)])
        with pytest.raises(SystemExit) as done:
            main()
        return done.value.code or 0, json.loads(capsys.readouterr().out)
    return call


def test_an_edge_spot_a_blend_and_a_saturated_one_are_set_aside_with_reasons(tmp_path, run):
    def scene(rng):
        spots = sound(rng)
        return [*spots, (2.0, 100.0, 3e4), (spots[8][0] + 5, spots[8][1] + 3, 2e4), (46.0, 48.0, 3e5)]
    _, said = run(written(tmp_path / "a", scene))
    aside = next(w for w in said["warnings"] if w.startswith("spots set aside"))
    assert "1 saturated" in aside and "1 at the edge" in aside and "too near to another" in aside
    assert said["quantities"]["fwhm_px"]["value"] == pytest.approx(2.3548 * np.sqrt(0.5), rel=0.02)


def test_a_moving_source_is_said(tmp_path, run):
    _, said = run(written(tmp_path / "a", sound, DRIFTING))
    assert any("drawn out in the same direction" in w and "move in the exposure" in w for w in said["warnings"])
    angle = said["quantities"]["ellipticity_angle_deg"]
    assert angle["value"] == pytest.approx(np.degrees(np.arctan2(0.8, 0.5) / 2), abs=4 * angle["uncertainty"])


@pytest.mark.parametrize(("scene", "why"), [
    (lambda rng: [], "usable spots"), (lambda rng: sound(rng, 5e5), "shorten the exposure"),
    (lambda rng: sound(rng)[:5], "5 usable spots, 10 are the least")])
def test_no_map_is_made_from_too_little(tmp_path, run, scene, why):
    out = tmp_path / "map.fits"
    code, said = run(written(tmp_path / "a", scene), "--map-out", out)
    assert code == 3 and why in said["error"]["what"] + (said["error"]["mend"] or "") and not out.exists()
