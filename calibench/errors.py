"""The errors that calibench raises on purpose. Each is one readable message: what, which file, how to mend it."""

from __future__ import annotations


class CalibenchError(Exception):
    """Base of all errors meant for the user; the command line prints the message and no traceback."""

    exit_code = 3

    def __init__(self, what: str, *, file: object = None, mend: str | None = None):
        self.what, self.file, self.mend = what, file, mend
        message = f"{file}: {what}" if file is not None else what
        if mend:
            message += f"\n  how to mend: {mend}"
        super().__init__(message)


class BadInput(CalibenchError):
    """The input cannot be used (exit code 3)."""


class UsageError(CalibenchError):
    """The command was called in a way that means nothing (exit code 2)."""

    exit_code = 2


class Contradiction(BadInput):
    """Two statements about one thing exclude each other. Never passed over: only the user knows which is true."""


class SeveralProblems(BadInput):
    """All mistakes of one input at once, each with its path inside the input."""

    def __init__(self, problems: list[tuple[str, str]], *, file: object = None, mend: str | None = None):
        self.problems = tuple(problems)
        lines = "".join(f"\n  {where}: {what}" for where, what in problems)
        super().__init__(f"{len(problems)} problem{'s' if len(problems) != 1 else ''}:{lines}", file=file, mend=mend)
