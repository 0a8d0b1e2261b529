import tomllib

import pytest

from calibench.io.toml_text import dumps


def test_what_is_written_is_read_back():
    tables = {"name": 'a "quoted"\nline', "n": 3, "x": 0.1, "yes": True, "list": [[1.5, 2], []], "none": None,
              "a": {"b": {"c d/e.png": {"k": [1, 2]}}, "f": -1e-30}, "empty": {}}
    back = tomllib.loads(dumps(tables))
    del tables["none"]
    assert back == tables


def test_infinity_is_toml_and_an_object_is_not():
    assert tomllib.loads(dumps({"x": float("inf")}))["x"] == float("inf")
    with pytest.raises(TypeError):
        dumps({"x": object()})
