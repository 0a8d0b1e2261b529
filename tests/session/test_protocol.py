from pathlib import Path

import pytest

from calibench.errors import BadInput, SeveralProblems
from calibench.session.places import protocol_file, protocols
from calibench.session.protocol import load_protocol

GOOD = protocol_file("star_camera").read_text()


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "session.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", protocols())
def test_every_shipped_protocol_is_valid_and_gives_its_reasons(name):
    protocol, sha256 = load_protocol(protocol_file(name))
    assert len(sha256) == 64 and protocol.protocol.why
    assert all(shot.what and shot.why for shot in protocol.shot)
    assert all(limit.why for limit in protocol.limits)


def test_all_mistakes_are_told_at_once_with_their_places(tmp_path):
    text = GOOD.replace('schema = 1', 'schema = 9').replace('folder = "darks"', 'folder = "../darks"')
    text = text.replace('kind = "flat"', 'kind = "bright"').replace('measure = "psf"', 'measure = "focus"')
    text = text.replace('quantity = "held_out_rms_px"\nmaximum = 0.5', 'quantity = "held_out_rms_px"\nminimun = 0.5')
    with pytest.raises(SeveralProblems) as caught:
        load_protocol(write(tmp_path, text))
    said = str(caught.value)
    for place in ("protocol.schema", "shot[1].folder", "shot[2].kind", "shot[3].measure", "limit[0].minimun"):
        assert place in said, said
    assert str(tmp_path) in said and "no known key" in said and "inside the session" in said


@pytest.mark.parametrize(("old", "new", "said"), [
    ('with = ["darks"]', 'with = ["nights"]', "no shot 'nights'"),
    ("hot_rate_per_s = 20.0", "hot_rate = 20.0", "measure.dark.hot_rate"),
    ('measurement = "psf"', 'measurement = "transfer"', "no shot is measured by 'transfer'"),
    ('name = "flats"', 'name = "darks"', "used twice"),
    ('identify = "pattern"', 'identify = "stars"', "known: angle, area_polar_moment, .* zhang"),
])
def test_tables_that_contradict_each_other_are_refused(tmp_path, old, new, said):
    with pytest.raises(SeveralProblems, match=said.replace("[", r"\[")):
        load_protocol(write(tmp_path, GOOD.replace(old, new)))


def test_what_is_no_protocol_is_refused(tmp_path):
    with pytest.raises(BadInput, match="not a TOML"):
        load_protocol(write(tmp_path, "[protocol"))
    with pytest.raises(BadInput, match="too many"):
        load_protocol(write(tmp_path, "#" * 300_000))
    with pytest.raises(BadInput, match="cannot be read"):
        load_protocol(tmp_path / "nothing.toml")
