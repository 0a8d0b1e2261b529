"""Sensor measurements at the command line: what must not become a figure is refused, what is doubtful stays in the JSON."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from calibench.cli.app import app
from calibench.errors import BadInput
from calibench.io.frame_writer import write_frame

SWAP = {"flat": "dark", "dark": "flat"}


@pytest.fixture()
def written(light_ladder, tmp_path):
    def write(kind_of=lambda kind: kind, celsius=lambda i: None, date_obs=lambda i: None, scale_s=1.0, only=None):
        for i, frame in enumerate(light_ladder(3, levels=10, stack=0, longest_s=0.1)):
            if frame.kind == only or only is None:
                folder = tmp_path / frame.kind
                folder.mkdir(exist_ok=True)
                write_frame(folder / f"{frame.file}.fits", frame.data, kind=kind_of(frame.kind), bit_depth=12,
                            exposure_s=frame.exposure_s * scale_s, temperature_c=celsius(i), date_obs=date_obs(i))
        return [str(folder) for folder in sorted(tmp_path.iterdir())]
    return write


def refusal(*words):
    done = CliRunner().invoke(app, [*words, "--json"])
    assert isinstance(done.exception, BadInput), done.output
    return str(done.exception)


def test_swapped_folders(written):
    assert "swapped" in refusal("transfer", *written(SWAP.get))


def test_drifting_temperature_stays_in_the_figures(written, tmp_path):
    done = CliRunner().invoke(app, ["transfer", *written(celsius=lambda i: 20 + 0.1 * i), "--json"])
    assert done.exit_code == 0, done.output
    assert any("temperature drifted from 20.0 to 23.9 C" in w for w in json.loads(done.stdout)["warnings"])


def test_milliseconds_given_as_seconds_do_not_fit_the_clock(written):
    said = refusal("dark", *written(date_obs=lambda i: f"2024-05-17T21:04:{i:02d}.5", scale_s=1000.0, only="dark"))
    assert "were taken within 19 s" in said and "in seconds" in said
