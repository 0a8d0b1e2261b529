"""Hostile and damaged lens files: each is refused with BadInput, in little time and memory, whatever it holds."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest

from calibench import registry
from calibench.errors import BadInput
from calibench.io.imports import _checked
from calibench.records import CalibrationMap, Intrinsics

NAMES = registry.names("calibench.io.imports")
MODEL = "{ 'lensmodel': 'LENSMODEL_PINHOLE', 'intrinsics': [ 500, 500, 320, 240 ], 'imagersize': [ 640, 480 ] }"


def good(name: str, path) -> bytes:
    lens = Intrinsics(model="brown5", fx_px=1416.7, fy_px=1417.0, cx_px=375.5, cy_px=239.125, image_size_px=(752, 480),
                      distortion=[-0.11, 0.2, 1e-4, -3e-7, 0.01], covariance=np.eye(9))
    calmap = CalibrationMap(image_size_px=(752, 480), intrinsics=lens, measured=frozenset(["intrinsics"]))
    registry.load("calibench.io.exports", name).export(calmap, path)
    return path.read_bytes()


def refused(name: str, path, limit_s: float = 2.0, limit_mb: float = 120.0) -> str:
    tracemalloc.start()
    start = time.process_time()
    try:
        with pytest.raises(BadInput) as caught:
            registry.load("calibench.io.imports", name).read(path)
        peak_mb = tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
    assert time.process_time() - start < limit_s and peak_mb < limit_mb
    message = str(caught.value)
    assert str(path) in message and "how to mend" in message and len(message) < 1000
    return message


@pytest.mark.parametrize("name", NAMES)
def test_every_truncation_is_refused_or_harmless(tmp_path, name):
    path = tmp_path / "camera"
    content = good(name, path)
    whole = registry.load("calibench.io.imports", name).read(path)
    came_through = 0
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        try:
            lens = registry.load("calibench.io.imports", name).read(path)
        except BadInput as error:
            assert str(path) in str(error)
        else:  # only what stands after the lens may be missing
            came_through += 1
            np.testing.assert_array_equal(lens.parameters, whole.parameters)
            assert np.isinf(np.diag(lens.covariance)).all() or np.array_equal(lens.covariance, whole.covariance)
    assert came_through < len(content) / 7 / 2


@pytest.mark.parametrize("name", NAMES)
def test_flipped_bytes_never_crash(tmp_path, name):
    path, rng = tmp_path / "camera", np.random.default_rng(4)
    content = np.frombuffer(good(name, path), np.uint8)
    for _ in range(400):
        damaged = content.copy()
        damaged[rng.integers(len(content), size=3)] = rng.integers(256, size=3)
        path.write_bytes(damaged.tobytes())
        try:
            lens = registry.load("calibench.io.imports", name).read(path)
        except BadInput as error:
            assert str(path) in str(error)
        else:
            assert np.isfinite(lens.parameters).all() and lens.fx_px > 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("content", [b"", b"\0" * 1000, b"\xff\xfe\x00junk", b"%YAML:1.0\n---\n", b"{", b"{}", b"[1]",
                                     b"SIMPLE  =                    T", b"import os\nos.abort()\n",
                                     b"{'lensmodel': __import__('os').abort()}"])
def test_what_is_no_lens_file(tmp_path, name, content):
    path = tmp_path / "camera"
    path.write_bytes(content)
    refused(name, path)


@pytest.mark.parametrize("name", NAMES)
def test_a_missing_file_a_folder_and_a_huge_file(tmp_path, name):
    assert "no such file" in refused(name, tmp_path / "nowhere")
    assert "not a file" in refused(name, tmp_path)
    path = tmp_path / "huge"
    with open(path, "wb") as handle:
        handle.truncate(50 * 2**30)  # sparse: it claims 50 GiB
    assert "larger than" in refused(name, path)


@pytest.mark.parametrize("content", [
    "[" * 1_000_000, "{'a': " + "[" * 1_000_000, "{'a': " + "(" * 5 + "1", "{" * 100_000, "{'a': {'b': 1}}",
    "{'a': [" + "1," * 2_000_000 + "]}", "{'a': " + "9" * 1_000_000 + "x", "{'a': 9**9**9}", "{'a': [1 2]}", "{'a' 1}",
    "{'a': 1, 'a': 2}", "{'a': 1} {", "{1: 2}", "{b'a': 2}", "#" * 1_000_000, "{'a': 'open", "{'a': None}"],
    ids=lambda text: text[:12])
def test_bombs_in_a_dictionary(tmp_path, content):
    path = tmp_path / "bomb.cameramodel"
    path.write_text(content)
    refused("mrcal_cameramodel", path)


@pytest.mark.parametrize(("old", "new"), [
    ("'LENSMODEL_PINHOLE'", "5"), ("'LENSMODEL_PINHOLE'", "['LENSMODEL_PINHOLE']"), ("'LENSMODEL_PINHOLE'", "'CAHVOR'"),
    ("500, 500,", "'500', 500,"), ("500, 500,", "[500], 500,"), ("500, 500,", "500,"), ("500, 500,", "1e999, 500,"),
    ("500, 500,", "nan, 500,"), ("500, 500,", "-500, 500,"), ("500, 500,", "0, 500,"), ("[ 500, 500, 320, 240 ]", "500"),
    ("640, 480", "640, 480, 3"), ("640, 480", "0, 480"), ("640, 480", "640.5, 480"), ("640, 480", "1e300, 480"),
    ("640, 480", "1e999, 480"), ("'imagersize'", "'size'"), ("'intrinsics'", "'lensmodel'")])
def test_wrong_types_and_values_in_a_dictionary(tmp_path, old, new):
    path = tmp_path / "wrong.cameramodel"
    path.write_text(MODEL)
    registry.load("calibench.io.imports", "mrcal_cameramodel").read(path)  # so that the refusal is of the change
    path.write_text(MODEL.replace(old, new))
    refused("mrcal_cameramodel", path)


@pytest.mark.parametrize(("old", "new"), [
    ("image_width: 752", "image_width: &a [*a, *a]"), ("image_width: 752", "image_width: !!python/object:os.abort {}"),
    ("image_width: 752", "image_width: " + "9" * 1_000_000), ("image_width: 752", "image_width: " + "9" * 1_000_000 + "x"),
    ("image_width: 752", "image_width: .Nan"), ("image_width: 752", "image_width: -752"), ("image_width: 752", "width: 752"),
    ("image_width: 752", "image_width: 752\nimage_width: 753"), ("rows: 3", "rows: 4"), ("rows: 3", "rows: 99999999999"),
    ("rows: 3", "rows: -3"), ("dt: d", "dt: u"), ("1416.7", "0x10"), ("1416.7", "1_4"), ("1416.7", ".Inf"), ("1416.7", "*a"),
    ("1416.7", "[1416.7]"), ("1416.7", ""), ("1416.7", "1416.7, " * 1_000_000 + "1"), ("lens_model: brown5", "lens_model: x"),
    ("%YAML", "YAML"), ("camera_matrix:", "camera_matrix"), ("1.0 ]", "1.0")],
    ids=lambda text: text[:24])
def test_wrong_types_and_values_in_yaml(tmp_path, old, new):
    path = tmp_path / "wrong.yml"
    text = good("opencv_yaml", path).decode()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    refused("opencv_yaml", path)


def test_the_largest_file_that_is_read_stays_small_in_memory(tmp_path):
    path = tmp_path / "large.cameramodel"
    filler = "'optimization_inputs': b'" + "x" * (_checked.MAX_BYTES - 200) + "', "
    path.write_text(MODEL.replace("{ ", "{ " + filler))
    assert registry.load("calibench.io.imports", "mrcal_cameramodel").read(path).fx_px == 500
