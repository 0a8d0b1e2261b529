"""Shots: what the protocol asks for against what lies in the session's folders."""

from __future__ import annotations

from pathlib import Path

from ..errors import BadInput
from ..io.frame_series import FrameSeries
from ..io.frames import find_frames
from ..records import Frame
from ..report.story import ShotStory
from .places import SESSION_FILE
from .protocol import Protocol, Shot, load_protocol
from .reading import read_or_reason

WRONG_KIND = "states that it is a {stated} frame, but lies among the {shot} ({wanted} frames): are the folders swapped?"


def open_session(folder: Path) -> tuple[Protocol, str]:
    """The protocol of a session folder (or of a protocol file) and its sha256.

    Raises:
        BadInput: no such folder, or no session.toml in it.
    """
    folder = Path(folder)
    if folder.is_dir() and not (folder / SESSION_FILE).is_file():
        raise BadInput(f"there is no {SESSION_FILE} in this folder", file=folder, mend=f"calibench new {folder}")
    if not folder.exists():
        raise BadInput("there is no such session folder", file=folder, mend=f"make one: calibench new {folder}")
    return load_protocol(folder / SESSION_FILE if folder.is_dir() else folder)


def shot_files(session: Path, shot: Shot) -> tuple[Path, ...]:
    """Frame files of one shot; none where the folder is missing or empty.

    Raises:
        BadInput: the folder leads (by a link) out of the session.
    """
    folder = (session / shot.folder).resolve()
    if not folder.is_relative_to(session.resolve()):
        raise BadInput("this folder leads out of the session", file=session / shot.folder,
                       mend="copy the frames into the session")
    if not folder.is_dir() or not any(folder.iterdir()):
        return ()
    return find_frames([session / shot.folder])


def read_shot(session: Path, shot: Shot) -> FrameSeries:
    """The frames of one shot, which may be none; each file is read when they are iterated.

    A frame that cannot be read, or states another kind, is left out and said; the session goes on if enough are left.
    """
    def read(path: Path, sha256: str) -> Frame | BadInput:
        frame = read_or_reason(path, shot.kind, named=False, sha256=sha256)
        if isinstance(frame, Frame) and frame.kind != shot.kind:
            return BadInput(WRONG_KIND.format(stated=frame.kind, shot=shot.name, wanted=shot.kind))
        return frame

    return FrameSeries(shot_files(session, shot), read, may_be_empty=True)


def judge_shot(shot: Shot, series: FrameSeries) -> ShotStory:
    """What the protocol's author would say of these frames.

    Raises:
        BadInput: the frames that are left do not belong together (sizes, depths, gains, automatic exposure).
    """
    frames = series.seen
    remarks = [f"{Path(file).name}: {why}" for file, why in series.rejected]
    exposures = {frame.exposure_s for frame in frames}
    enough = len(frames) >= shot.frames and len(exposures) >= shot.exposures
    if len(frames) < shot.frames:
        remarks.append(f"{len(frames)} of {shot.frames} frames")
    if len(exposures) < shot.exposures and frames:
        remarks.append(f"{len(exposures)} of {shot.exposures} different exposures")
    notes = {note for frame in frames for note in frame.notes}
    remarks += sorted(notes)
    status = "pass" if enough else "skipped" if shot.optional and not frames else "fail"
    return ShotStory(name=shot.name, folder=shot.folder, what=shot.what, why=shot.why, wanted=shot.frames, found=len(frames),
                     status=status, remarks=tuple(remarks))
