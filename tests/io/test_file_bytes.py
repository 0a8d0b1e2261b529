from __future__ import annotations

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.io import file_bytes as module
from calibench.io.file_bytes import file_bytes, free_spare


def test_memory_serves_again_only_when_nothing_refers_to_it(tmp_path):
    free_spare()
    paths = [tmp_path / name for name in "abc"]
    for value, path in enumerate(paths):
        path.write_bytes(bytes([value]) * 5000)
    held = np.frombuffer(file_bytes(paths[0]), np.uint16)[10:]
    address = held.__array_interface__["data"][0]
    other = np.frombuffer(file_bytes(paths[1]), np.uint8)
    assert not len(module._spare)
    assert np.all(held == 0) and np.all(other == 1)
    del held
    assert len(module._spare) == 1
    again = np.frombuffer(file_bytes(paths[2]), np.uint8)
    assert again.ctypes.data == address - 20
    assert np.all(other == 1) and np.all(again == 2) and not again.flags.writeable


def test_after_the_last_file_nothing_is_kept(tmp_path):
    (tmp_path / "a").write_bytes(b"x" * 5000)
    held = file_bytes(tmp_path / "a")
    free_spare()
    del held
    assert not len(module._spare)


def test_a_file_gives_its_own_bytes_from_larger_memory(tmp_path):
    free_spare()
    (tmp_path / "long").write_bytes(b"x" * 1000)
    (tmp_path / "short").write_bytes(b"y" * 700)
    file_bytes(tmp_path / "long")
    assert bytes(file_bytes(tmp_path / "short")) == b"y" * 700


def test_empty_and_missing_files_are_refused(tmp_path):
    (tmp_path / "empty").touch()
    with pytest.raises(BadInput, match="empty"):
        file_bytes(tmp_path / "empty")
    with pytest.raises(BadInput, match="cannot be opened"):
        file_bytes(tmp_path / "missing")
