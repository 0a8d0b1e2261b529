"""Tables kept between runs: built once, and anew where the kept file is not to be trusted."""

from typing import NamedTuple

import numpy as np
import pytest

from calibench.io.star_cache import kept


class Table(NamedTuple):
    codes: np.ndarray
    rows: np.ndarray


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("CALIBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


class Builder:
    """Builds a table and counts how often it was asked to."""

    def __init__(self) -> None:
        self.asked = 0

    def __call__(self) -> Table:
        self.asked += 1
        return Table(codes=np.arange(300, dtype=np.float32), rows=np.arange(12, dtype=np.int32).reshape(4, 3))


def test_a_table_is_built_once(folder, capsys):
    build = Builder()
    first, second = kept("pattern-1", Table, build), kept("pattern-1", Table, build)
    assert build.asked == 1 and isinstance(second, Table)
    for a, b in zip(first, second, strict=True):
        assert a.dtype == b.dtype and (a == b).all()
    assert [file.name for file in folder.iterdir()] == ["pattern-1.npz"] and not capsys.readouterr().err
    kept("pattern-2", Table, build)
    assert build.asked == 2


def flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 64]) + content[middle + 1:]


@pytest.mark.parametrize("damage", [flip, lambda c: c[:len(c) // 3], lambda c: b"", lambda c: b"PK\x03\x04 nonsense" * 9])
def test_a_damaged_file_is_built_anew_and_said(folder, capsys, damage):
    build = Builder()
    kept("pattern-1", Table, build)
    file = folder / "pattern-1.npz"
    file.write_bytes(damage(file.read_bytes()))
    table = kept("pattern-1", Table, build)
    assert build.asked == 2 and (table.codes == np.arange(300)).all()
    assert "pattern-1.npz" in capsys.readouterr().err
    kept("pattern-1", Table, build)
    assert build.asked == 2  # the damaged one was replaced


@pytest.mark.parametrize("foreign", [
    {"codes": np.arange(300), "rows": np.zeros((4, 3)), "hash": np.array("0" * 64)}, {"codes": np.arange(3)},
    {"codes": np.array([{"an": "object"}], dtype=object), "rows": np.zeros(1), "hash": np.array("")}])
def test_another_programs_file_is_not_taken(folder, capsys, foreign):
    folder.mkdir()
    np.savez(folder / "pattern-1.npz", **foreign)
    assert (kept("pattern-1", Table, Builder()).codes == np.arange(300)).all()
    assert "not used" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_costs_only_time(folder, capsys):
    folder.write_text("a file in the way")
    assert (kept("pattern-1", Table, Builder()).codes == np.arange(300)).all()
    assert "not kept" in capsys.readouterr().err
