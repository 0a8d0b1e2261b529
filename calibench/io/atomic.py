"""Writing a file whole or not at all: a failed write leaves the old file as it was and no half-written one behind."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

from ..errors import BadInput


def write_bytes(path: Path | str, content: bytes) -> None:
    """Replace the file at `path` by `content`, atomically.

    The bytes go to a temporary file in the same folder (a rename is atomic only within one file system), reach the disk
    (fsync) and then take the file's name. The folder is synced too, so that the rename itself survives a power cut.
    A symbolic link is followed, and an existing file keeps its permissions.

    Raises:
        BadInput: the folder is missing or not writable, the disk is full, ...; what was there before is untouched.
    """
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".calibench-{secrets.token_hex(6)}.part")
    try:
        try:
            _write_and_sync(temporary, content)
            if target.exists():
                os.chmod(temporary, target.stat().st_mode & 0o777)
            os.replace(temporary, target)
        except BaseException:  # also an interrupt from the keyboard must not leave the temporary file
            temporary.unlink(missing_ok=True)
            raise
        _sync_folder(target.parent)
    except OSError as error:
        before = "; the file that was there is unchanged" if target.is_file() else ""
        raise BadInput(f"could not be written: {error.strerror or error}{before}", file=path,
                       mend=f"check that {target.parent} exists, is writable and has {len(content) / 1e6:.1f} MB free"
                       ) from error


def make_folder(path: Path | str) -> None:
    """Make a folder and those above it.

    Raises:
        BadInput: it cannot be made, or a file of that name is in the way.
    """
    try:
        Path(path).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"this folder cannot be made: {error.strerror or error}", file=path,
                       mend="name a folder that can be written to") from error


def _write_and_sync(path: Path, content: bytes) -> None:
    with open(path, "xb") as handle:
        handle.write(content)
        handle.flush()
        os.fsync(handle.fileno())


def _sync_folder(folder: Path) -> None:
    if os.name == "nt":  # Windows cannot open a folder, and its rename is journalled by the file system
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
