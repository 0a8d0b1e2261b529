"""FrameSeries: frames on demand, checked on the way, the same in every pass."""

from __future__ import annotations

import threading
import weakref
from pathlib import Path

import numpy as np
import pytest

from calibench.errors import BadInput
from calibench.io import frame_series
from calibench.io.frame_series import FrameSeries, Joined
from calibench.io.frame_writer import write_frame
from calibench.io.frames import read_frame
from calibench.io.read_ahead import read_ahead

SHAPE = (40, 60)


def written(folder: Path, levels_dn, *, bit_depth=12, **said) -> list[Path]:
    paths = []
    for i, level in enumerate(levels_dn):
        data = np.random.default_rng(i).normal(level, 3, SHAPE).astype(np.uint16)
        paths.append(folder / f"{i}.fits")
        write_frame(paths[-1], data, **({"kind": "flat", "exposure_s": 0.1, "bit_depth": bit_depth} | said))
    return paths


class Reader:
    """read_frame, counting what is read and hashed; BadInput is the reason for leaving a frame out."""

    def __init__(self):
        self.read, self.hashed, self._lock = [], [], threading.Lock()

    def __call__(self, path, sha256):
        with self._lock:
            self.read.append(path.name)
            self.hashed += [] if sha256 else [path.name]
        try:
            return read_frame(path, sha256=sha256)
        except BadInput as fault:
            return fault


@pytest.fixture
def nothing_kept(monkeypatch):
    monkeypatch.setattr(frame_series, "KEPT_BYTES", 0)


def test_every_pass_gives_the_same_frames(tmp_path, nothing_kept):
    paths, read = written(tmp_path, [500] * 5), Reader()
    series = FrameSeries(paths, read)
    first, second = list(series), list(series)
    assert [f.file for f in first] == [str(p) for p in paths] == [f.file for f in second]
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.data, b.data)
        assert (a.sha256, a.notes, a.bit_depth) == (b.sha256, b.notes, b.bit_depth) and len(a.sha256) == 64
    assert len(read.read) == 10 + 1 and len(read.hashed) == 5 + 1  # the first of all is looked at first


def test_a_small_series_is_read_once(tmp_path):
    read = Reader()
    series = FrameSeries(written(tmp_path, [500] * 4), read)
    assert len(list(series)) == len(list(series)) == len(series.seen) == 4
    assert sorted(set(read.read)) == ["0.fits", "1.fits", "2.fits", "3.fits"] and len(read.read) == 4 + 1


def test_memory_holds_few_frames_at_a_time(tmp_path, nothing_kept):
    alive, most, lock = set(), [], threading.Lock()

    def read(path, sha256):
        frame = read_frame(path, sha256=sha256)
        with lock:
            alive.add(path)
            most.append(len(alive))
        weakref.finalize(frame, alive.discard, path)
        return frame

    for _ in FrameSeries(written(tmp_path, [500] * 20), read):
        pass
    assert max(most) <= 5


def test_what_cannot_be_used_is_left_out_once_with_its_reason(tmp_path, nothing_kept):
    paths = written(tmp_path, [500] * 5)
    paths[2].write_bytes(paths[2].read_bytes()[:3000])
    series = FrameSeries(paths, Reader())
    assert len(list(series)) == len(list(series)) == 4
    assert [file for file, _ in series.rejected] == [str(paths[2])] and series.rejected[0][1]


def test_what_must_not_be_passed_over_is_raised(tmp_path):
    paths = written(tmp_path, [500] * 3)
    paths[1].write_bytes(b"")
    with pytest.raises(BadInput, match="1.fits"):
        list(FrameSeries(paths, lambda path, sha256: read_frame(path)))


def test_nothing_left_says_why(tmp_path):
    paths = written(tmp_path, [500, 500])
    for path in paths:
        path.write_bytes(b"")
    with pytest.raises(BadInput, match="no frame could be used:\n.*0.fits.*empty.*\n.*1.fits"):
        list(FrameSeries(paths, Reader()))
    assert FrameSeries(paths, Reader(), may_be_empty=True).seen == ()


@pytest.mark.parametrize("kept", [0, 10**9])
def test_mixed_frames_are_refused_with_all_groups(tmp_path, monkeypatch, kept):
    monkeypatch.setattr(frame_series, "KEPT_BYTES", kept)
    paths = written(tmp_path, [500] * 6)
    for i in (2, 4, 5):
        gain = float(i > 3)
        write_frame(paths[i], np.full(SHAPE, 500, np.uint16), kind="flat", exposure_s=0.1, bit_depth=12, gain_setting=gain)
    taken = []
    with pytest.raises(BadInput) as error:
        taken += [f.name for f in FrameSeries(paths, Reader())]
    message = str(error.value)
    assert "mixed in gain" in message
    assert [line.split()[0] for line in message.splitlines()[2:5]] == ["3", "1", "2"]


def test_an_automatic_is_refused_at_the_end_of_the_pass(tmp_path, nothing_kept):
    frames = iter(FrameSeries(written(tmp_path, [400, 405, 520, 660, 655, 520]), Reader()))
    assert len([next(frames) for _ in range(6)]) == 6
    with pytest.raises(BadInput, match="6 flats state one exposure"):
        next(frames)


@pytest.mark.parametrize("kept", [0, 10**9])
def test_the_range_of_the_series_is_known_before_its_first_frame(tmp_path, monkeypatch, kept):
    monkeypatch.setattr(frame_series, "KEPT_BYTES", kept)
    series = FrameSeries(written(tmp_path, [500, 500, 3000], bit_depth=None, exposure_s=None), Reader())
    for _ in range(2):
        assert [(f.bit_depth, f.white_level_dn) for f in series] == [(12, 4095.0)] * 3
    assert "12 bits assumed: the largest value of the series is 30" in series.seen[0].notes[-1]


def test_left_aligned_frames_shift_the_poor_one_that_follows_or_leads(tmp_path, nothing_kept):
    rich = (np.random.default_rng(0).integers(30, 90, SHAPE) << 4).astype(np.uint16)
    for folder, order in (("a", (rich, np.full(SHAPE, 16, np.uint16))), ("b", (np.full(SHAPE, 16, np.uint16), rich))):
        (tmp_path / folder).mkdir()
        paths = [tmp_path / folder / f"{i}.fits" for i in range(2)]
        for path, data in zip(paths, order, strict=True):
            write_frame(path, data, kind="light", exposure_s=0.1)
        series = FrameSeries(paths, Reader())
        for _ in range(2):
            assert [(f.bit_depth, int(f.data.min())) for f in series if f.data.max() < 2] == [(12, 1)]


def test_a_file_that_changes_between_two_passes_is_refused(tmp_path, nothing_kept):
    paths = written(tmp_path, [500] * 3)
    series = FrameSeries(paths, Reader())
    list(series)
    written(tmp_path, [600] * 3)
    with pytest.raises(BadInput, match="0.fits: was changed"):
        list(series)


def test_copies_are_noted(tmp_path, nothing_kept):
    paths = written(tmp_path, [500] * 3)
    paths[2].write_bytes(paths[0].read_bytes())
    series = FrameSeries(paths, Reader())
    for _ in range(2):
        assert [("the same, byte for byte, as 0.fits" in " ".join(f.notes)) for f in series] == [False, False, True]


def test_joined_series_may_be_iterated_again(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    joined = Joined(*(FrameSeries(written(tmp_path / name, [500] * 2), Reader()) for name in ("a", "b")))
    names = [f.label for f in joined]
    assert names == ["a/0.fits", "a/1.fits", "b/0.fits", "b/1.fits"] == [f.label for f in joined]


def test_reading_ahead_keeps_order_and_raises_in_turn():
    def halve(n):
        if n % 2:
            raise BadInput(f"{n} is odd")
        return n // 2
    found = []
    with pytest.raises(BadInput, match="7 is odd"):
        found += [n for n in read_ahead(halve, [0, 2, 4, 6, 8, 7, 2])]
    assert list(read_ahead(halve, range(0, 40, 2))) == list(range(20))
    taken = read_ahead(halve, iter([0, 2, 4, 1, 3]))
    assert [next(taken), next(taken)] == [0, 1]
    taken.close()
