"""The EMVA 1288 descriptor: a text file that lists the frames of a photon transfer series with exposure and photons.

    n 12 640 480            bits, width, height
    b 40000 120.5           bright level: exposure in ns, photons a pixel; its images follow
    i images/b_000_1.png    path relative to the descriptor
    d 40000                 dark level: exposure in ns

`#` begins a comment, `v` a version. Two images make a level, more a stack.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ..errors import BadInput, SeveralProblems
from ..records import Frame
from .file_bytes import free_spare
from .frames import read_frame
from .metadata import FrameMetadata
from .read_ahead import read_ahead

MAX_BYTES = 10_000_000
LONGEST_NS, SHORTEST_LONGEST_NS = 86400e9, 1000.0  # outside, no ladder is in nanoseconds
FORMS = {"n": "n bits width height", "b": "b exposure_ns photons", "d": "d exposure_ns", "i": "i path/of/the/image"}


@dataclass(frozen=True, kw_only=True)
class DescribedFrame:
    """One image of the descriptor and what its block says."""

    path: Path
    kind: str
    exposure_s: float
    photons: float


@dataclass(frozen=True, kw_only=True)
class Descriptor:
    """Frames level by level, in the order of the file."""

    file: Path
    bit_depth: int
    image_size_px: tuple[int, int]
    frames: tuple[DescribedFrame, ...]


def read_descriptor(path: Path) -> Descriptor:
    """Parse a descriptor; no image is opened.

    Raises:
        BadInput: missing, too large, or no text. SeveralProblems: every line that is wrong, at once.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise BadInput("is too large for a descriptor", file=path, mend="give the text file, not an image")
        text = path.read_text(encoding="utf-8")
    except OSError as fault:
        raise BadInput(f"cannot be read: {fault.strerror}", file=path, mend="check the path") from fault
    except UnicodeDecodeError as fault:
        raise BadInput("is no text file", file=path, mend="give the descriptor, not an image") from fault
    parser = _Parser(path)
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split(maxsplit=1)
        if words and not words[0].startswith("#"):
            parser.take(number, words[0], words[1].strip() if len(words) > 1 else "")
    return parser.finish()


def described_frames(descriptor: Descriptor) -> Iterator[Frame]:
    """The frames one after the other, read ahead, with kind, exposure, photons and bits as the descriptor says.

    Raises:
        BadInput: an image cannot be read, contradicts the descriptor, or has another size.
    """
    def read(said: DescribedFrame) -> Frame:
        known = FrameMetadata(kind=said.kind, exposure_s=said.exposure_s, bit_depth=descriptor.bit_depth)
        frame = read_frame(said.path, said.kind, protocol=known)
        if frame.image_size_px != descriptor.image_size_px:
            (w, h), (said_w, said_h) = frame.image_size_px, descriptor.image_size_px
            raise BadInput(f"is {w} x {h} px, but {descriptor.file.name} says n ... {said_w} {said_h}", file=said.path,
                           mend="correct the line n of the descriptor")
        return dataclasses.replace(frame, photons_per_px=said.photons)

    yield from read_ahead(read, descriptor.frames)
    free_spare()


class _Parser:
    """Takes the lines; keeps every problem with the line it stands on."""

    def __init__(self, path: Path):
        self._path = path
        self._format: tuple[int, int, int] | None = None
        self._block: tuple[str, float, float] | None = None
        self._frames: list[DescribedFrame] = []
        self._problems: list[tuple[str, str]] = []

    def take(self, line: int, word: str, rest: str) -> None:
        if word == "v":
            return
        if word not in FORMS:
            self._wrong(line, f"begins with '{word}'; lines begin with {', '.join(FORMS)}, v or #")
        elif word == "i":
            self._image(line, rest)
        else:
            self._numbers(line, word, rest.replace(",", ".").split())

    def finish(self) -> Descriptor:
        longest = 1e9 * max((f.exposure_s for f in self._frames), default=0.0)
        if self._frames and not SHORTEST_LONGEST_NS <= longest <= LONGEST_NS:
            self._problems.append(("exposures", f"the longest is {longest:g} ns: exposures in a descriptor are in nanoseconds"))
        if self._format is None:
            self._problems.insert(0, ("line n", f"is missing: {FORMS['n']}"))
        if not self._frames and not self._problems:
            self._problems.append(("images", "the descriptor names none"))
        if self._problems:
            raise SeveralProblems(self._problems, file=self._path, mend="correct these lines of the descriptor")
        bits, width, height = self._format
        return Descriptor(file=self._path, bit_depth=bits, image_size_px=(width, height), frames=tuple(self._frames))

    def _numbers(self, line: int, word: str, parts: list[str]) -> None:
        try:
            values = [float(part) for part in parts]
        except ValueError:
            values = []
        wanted = len(FORMS[word].split()) - 1
        if len(values) != wanted or not all(math.isfinite(v) and v >= 0 for v in values):
            self._wrong(line, f"should read: {FORMS[word]}")
        elif word == "n" and not (1 <= values[0] <= 16 and min(values[1:]) >= 1 and all(v == int(v) for v in values)):
            self._wrong(line, "bits are 1 to 16, width and height whole pixels")
        elif word == "n" and self._format is not None:
            self._wrong(line, "a second line n: one descriptor is of one image size")
        elif word == "n":
            self._format = tuple(int(v) for v in values)
        else:
            self._block = ("flat", *values) if word == "b" else ("dark", values[0], 0.0)

    def _image(self, line: int, rest: str) -> None:
        inside = PurePosixPath(rest.replace("\\", "/"))
        if self._block is None:
            self._wrong(line, "an image before any line b or d")
        elif not rest:
            self._wrong(line, f"should read: {FORMS['i']}")
        elif inside.is_absolute() or ".." in inside.parts or ":" in rest:
            self._wrong(line, "the image must lie in the descriptor's folder or below")
        elif not (file := self._path.parent / inside).is_file():
            self._wrong(line, f"there is no file {inside}")
        else:
            kind, exposure_ns, photons = self._block
            self._frames.append(DescribedFrame(path=file, kind=kind, exposure_s=exposure_ns * 1e-9, photons=photons))

    def _wrong(self, line: int, what: str) -> None:
        self._problems.append((f"line {line}", what))
