"""Open folders: a package whose every module is one choice. One new file is the whole change.

`names` lists the folder, `load` imports one file of it. A file whose name starts with an underscore, and `kernels`,
are the folder's own tools and no choices; nor is a folder inside it.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from types import ModuleType

from .errors import UsageError


def names(folder: str) -> tuple[str, ...]:
    """Names of the choices in an open folder, e.g. ``names("calibench.spots.detect")``, sorted."""
    package = importlib.import_module(folder)
    found = (info.name for info in pkgutil.iter_modules(package.__path__) if not info.ispkg)
    return tuple(sorted(name for name in found if not name.startswith("_") and name != "kernels"))


@cache
def load(folder: str, name: str) -> ModuleType:
    """The module of one choice.

    Raises:
        UsageError: no such choice; the message lists the known names.
    """
    known = names(folder)
    if name not in known:
        what = folder.removeprefix("calibench.").replace(".", "/")
        raise UsageError(f"{what} has no '{name}'", mend=f"choose one of: {', '.join(known)}")
    return importlib.import_module(f"{folder}.{name}")
