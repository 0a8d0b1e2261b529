"""Where the project keeps its protocols and its sample session."""

from __future__ import annotations

from pathlib import Path

from ..errors import BadInput, UsageError

ROOT = Path(__file__).resolve().parents[2]
SESSION_FILE = "session.toml"
TRUTH_FILE = "truth.toml"


def protocols() -> dict[str, Path]:
    """Name -> file of the protocols that come with the project."""
    return {file.stem: file for file in sorted((ROOT / "protocols").glob("*.toml"))}


def protocol_file(name: str) -> Path:
    """The file of a named protocol.

    Raises:
        UsageError: no such protocol, or an installation without them.
    """
    known = protocols()
    if name not in known:
        raise UsageError(f"there is no protocol '{name}'", mend=f"known: {', '.join(known) or 'none on this machine'}")
    return known[name]


def sample_frames() -> Path:
    """The shipped lab session.

    Raises:
        BadInput: an installation without it.
    """
    folder = ROOT / "sample_frames"
    if not (folder / SESSION_FILE).is_file():
        raise BadInput("the sample session is missing", file=folder,
                       mend="run from a clone of the project, or render one: calibench simulate session sample_frames")
    return folder
