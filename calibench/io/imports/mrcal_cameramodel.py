"""mrcal's .cameramodel: the text of a Python dictionary, with comments.

Read by a tokenizer of its own, not by Python's: ast.literal_eval runs no code, but builds a tree hundreds of times the size
of the text, and a list of lists can exhaust its stack. Here nesting and the number of values are limited.
mrcal's integer coordinates are the centres of pixels, (0, 0) the top-left one, as here. Its OPENCV models keep OpenCV's
order of coefficients. Uncertainty is not in the file as such (mrcal computes it from the observations): it is unknown here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from ...errors import BadInput
from ...records import DISTORTION_NAMES, Intrinsics
from ..exports.mrcal_cameramodel import MODELS
from ._checked import DAMAGED_MEND, NUMBER, checked_lens, text_of

MAX_DEPTH = 4
MAX_VALUES = 20_000
_TOKEN = re.compile(r"(?P<space>\s+|#[^\n]*)|(?P<text>b?'[^'\\\n]*'|b?\"[^\"\\\n]*\")|(?P<mark>[][{}:,()])|"
                    rf"(?P<number>{NUMBER})")

Token = tuple[str, str, int]
Value = str | float | list


def read(path: Path | str) -> Intrinsics:
    """The lens of a camera model; extrinsics, valid region and optimization inputs are left aside.

    Raises:
        BadInput: not such a file, an entry is missing or malformed, or a lens model that calibench has not.
    """
    entries = _Reader(text_of(path), path).dictionary()
    missing = [name for name in ("lensmodel", "intrinsics", "imagersize") if name not in entries]
    if missing:
        raise BadInput(f"has no {', '.join(missing)}; it has: {', '.join(list(entries)[:20]) or 'nothing'}", file=path,
                       mend=DAMAGED_MEND)
    ours = {theirs: model for model, theirs in MODELS.items()}
    model = ours.get(entries["lensmodel"]) if isinstance(entries["lensmodel"], str) else None
    if model is None:
        raise BadInput(f"its lens model {str(entries['lensmodel'])[:80]} is not one of {', '.join(ours)}", file=path,
                       mend="convert it: mrcal-convert-lensmodel LENSMODEL_OPENCV8 FILE")
    size = _numbers(entries, "imagersize", 2, path)
    return checked_lens(model, _numbers(entries, "intrinsics", 4 + len(DISTORTION_NAMES[model]), path), size, path)


def _numbers(entries: dict[str, Value], name: str, count: int, path: Path | str) -> list[float]:
    values = entries[name]
    if not isinstance(values, list) or len(values) != count or not all(isinstance(v, float) for v in values):
        raise BadInput(f"its {name} is not a list of {count} numbers", file=path, mend=DAMAGED_MEND)
    return values


class _Reader:
    """One text, read token by token: dictionary = { text : value , ... }, value = text | number | [ value , ... ]."""

    def __init__(self, text: str, path: Path | str):
        self.text, self.path, self.values = text, path, 0
        self.tokens = self._tokens()

    def dictionary(self) -> dict[str, Value]:
        entries: dict[str, Value] = {}
        self._expect("{")
        while (token := self._next())[1] != "}":
            if token[0] != "text" or token[1].startswith("b") or _content(token) in entries:
                raise self._wrong(token, "the name of a new entry")
            self._expect(":")
            entries[_content(token)] = self._value(self._next(), 0)
            if not self._goes_on("}"):
                break
        if (token := self._next())[0] != "end":
            raise self._wrong(token, "the end of the file")
        return entries

    def _value(self, token: Token, depth: int) -> Value:
        self.values += 1
        if self.values > MAX_VALUES or depth > MAX_DEPTH:
            raise self._wrong(token, f"at most {MAX_VALUES} values, {MAX_DEPTH} lists deep")
        kind, text, _ = token
        if kind == "number":
            return float(text)
        if kind == "text":
            return _content(token)
        if text not in ("[", "("):
            raise self._wrong(token, "a text, a number or a list")
        close, items = {"[": "]", "(": ")"}[text], []
        while (token := self._next())[1] != close:
            items.append(self._value(token, depth + 1))
            if not self._goes_on(close):
                break
        return items

    def _goes_on(self, close: str) -> bool:
        """Whether a comma follows; otherwise the closing bracket must."""
        token = self._next()
        if token[1] not in (",", close):
            raise self._wrong(token, f"a comma or {close}")
        return token[1] == ","

    def _expect(self, mark: str) -> None:
        if (token := self._next())[1] != mark:
            raise self._wrong(token, mark)

    def _next(self) -> Token:
        return next(self.tokens)

    def _tokens(self) -> Iterator[Token]:
        at = 0
        while at < len(self.text):
            found = _TOKEN.match(self.text, at)
            if found is None:
                raise self._wrong(("nothing", self.text[at], at), "a text, a number or a bracket")
            at = found.end()
            if found.lastgroup != "space":
                yield found.lastgroup, found.group(), found.start()
        while True:
            yield "end", "the end", at

    def _wrong(self, token: Token, expected: str) -> BadInput:
        line = self.text.count("\n", 0, token[2]) + 1
        return BadInput(f"line {line}: {token[1][:40]!r} stands where {expected} is expected", file=self.path,
                        mend=DAMAGED_MEND)


def _content(token: Token) -> str:
    return token[1].removeprefix("b")[1:-1]
