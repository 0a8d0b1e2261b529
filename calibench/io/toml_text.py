"""Plain nested dicts as TOML text (the standard library reads TOML but does not write it)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence

BARE_KEY = re.compile(r"^[A-Za-z0-9_-]+$")


def dumps(tables: Mapping[str, object]) -> str:
    """TOML of dicts, lists, text, numbers and booleans; None values are left out.

    Raises:
        TypeError: a value of another kind.
    """
    return "".join(_table(tables, ())).lstrip("\n")


def _table(table: Mapping[str, object], path: tuple[str, ...]) -> list[str]:
    values = {k: v for k, v in table.items() if v is not None and not isinstance(v, Mapping)}
    lines = [f"\n[{'.'.join(map(_key, path))}]\n"] if path and (values or not table) else []
    lines += [f"{_key(k)} = {_value(v)}\n" for k, v in values.items()]
    for key, inner in table.items():
        if isinstance(inner, Mapping):
            lines += _table(inner, (*path, key))
    return lines


def _key(key: str) -> str:
    return key if BARE_KEY.match(key) else json.dumps(key)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=True)  # JSON's escapes are TOML's
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else ("nan" if math.isnan(value) else "inf" if value > 0 else "-inf")
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, Sequence):
        return "[" + ", ".join(map(_value, value)) + "]"
    raise TypeError(f"{type(value).__name__} does not go into TOML")
