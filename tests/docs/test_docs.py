"""The documents against the code: what is offered is described, and what is described is there."""

from __future__ import annotations

import importlib
import pkgutil
import re
from pathlib import Path

import pytest
import typer
from pydantic import BaseModel

import calibench
from calibench import registry
from calibench.cli.app import app
from calibench.io import sidecar
from calibench.records import DEFECT_FLAGS, DISTORTION_NAMES, IMAGE_LAYERS
from calibench.session import protocol

LARGEST_PICTURE_BYTES = 300_000


def page(root: Path, name: str) -> str:
    return (root / "docs" / f"{name}.md").read_text(encoding="utf-8")


def pages(root: Path) -> list[Path]:
    return [root / "README.md", root / "CHANGELOG.md", *sorted((root / "docs").rglob("*.md"))]


def sections(text: str, level: int) -> dict[str, str]:
    """Heading -> the text under it, for headings of one level."""
    parts = re.split(rf"^{'#' * level} (.+)$", text, flags=re.MULTILINE)[1:]
    return {head: re.split(rf"^#{{1,{level}}} ", body, maxsplit=1, flags=re.MULTILINE)[0]
            for head, body in zip(parts[::2], parts[1::2], strict=True)}


def commands() -> dict[str, list[str]]:
    """Full name of each command -> its options."""
    def walk(command, name):
        if hasattr(command, "commands"):
            for child, below in command.commands.items():
                yield from walk(below, [*name, child])
        else:
            yield " ".join(name), [o for p in command.params for o in p.opts if o.startswith("--")]
    return dict(walk(typer.main.get_command(app), []))


def open_folders() -> list[str]:
    """Every package that calls itself an open folder, or holds the choices of one, by its dotted name."""
    found = {"calibench.measure", "calibench.io.readers", "calibench.io.exports", "calibench.report.sections"}
    for info in pkgutil.walk_packages(calibench.__path__, "calibench."):
        if info.ispkg and not info.name.rsplit(".", 1)[1].startswith("_"):
            if "open folder" in (importlib.import_module(info.name).__doc__ or "").lower():
                found.add(info.name)
    return sorted(found)


def tables(model: type[BaseModel]) -> list[type[BaseModel]]:
    return [t for t in vars(protocol).values()
            if isinstance(t, type) and issubclass(t, model) and t.__module__ == protocol.__name__ and t.model_fields]


@pytest.mark.parametrize("name", commands())
def test_every_command_and_option_is_described(root, name):
    described = sections(page(root, "commands"), 3)
    entry = next((text for head, text in described.items() if f"`{name}`" in head), None)
    assert entry is not None, f"docs/commands.md has no section for `{name}`"
    # --json is described once for the measurements, in their common table
    missing = [option for option in commands()[name] if not re.search(rf"`{option}`", entry)]
    assert not missing, f"`{name}` in docs/commands.md lacks {', '.join(missing)}"


def test_no_command_is_described_that_is_not_there(root):
    described = {name for head in sections(page(root, "commands"), 3) for name in re.findall(r"`([a-z -]+)`", head)}
    assert described == set(commands())


@pytest.mark.parametrize("folder", open_folders())
def test_every_choice_of_an_open_folder_is_described(root, folder):
    text = sections(page(root, "architecture"), 2)["Open folders"]
    short = folder.removeprefix("calibench.").replace(".", "/") + "/"
    row = next((line for line in text.splitlines() if line.startswith(f"| `{short}` |")), None)
    assert row is not None, f"docs/architecture.md: no row for {short}"
    assert re.findall(r"`(\w+)`", row.split("|")[2]) == list(registry.names(folder)), short


def test_the_table_of_rooms_is_that_of_the_package(root):
    text = sections(page(root, "architecture"), 2)["Rooms"]
    rows = [line.split("|")[1:3] for line in text.splitlines() if re.match(r"\| \d+ \|", line)]
    numbers = {room: int(number) for number, rooms in rows for room in re.findall(r"`(\w+)`", rooms)}
    package = root / "calibench"
    there = {f.name for f in package.iterdir() if f.is_dir() and (f / "__init__.py").is_file()}
    there |= {f.stem for f in package.glob("*.py")} - {"__init__", "__main__"}
    assert set(numbers) == there
    assert list(numbers.values()) == sorted(numbers.values())


@pytest.mark.parametrize("table", tables(BaseModel), ids=lambda t: t.__name__)
def test_every_key_of_a_protocol_is_described(root, table):
    text = page(root, "protocol")
    keys = [field.alias or name for name, field in table.model_fields.items()]
    assert keys
    for key in keys:
        assert re.search(rf"`\[*{key}(\]\]|\]|\.NAME\])?`", text), f"docs/protocol.md lacks {table.__name__}.{key}"


@pytest.mark.parametrize("name", registry.names("calibench.measure"))
def test_every_setting_of_a_measurement_is_described_with_its_default(root, name):
    rows = {}
    head = None
    for line in page(root, "protocol").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 4 and re.fullmatch(r"(`\[measure\.\w+\]`)?", cells[0]) and cells[1].startswith("`"):
            head = cells[0].strip("`[]") or head
            rows[head, cells[1].strip("`")] = cells[2]
    settings = registry.load("calibench.measure", name).Settings
    described = {key: said for (table, key), said in rows.items() if table == f"measure.{name}"}
    assert set(described) == set(settings.__dataclass_fields__)
    for key, value in vars(settings()).items():
        if value is not None:
            shown = str(list(value)) if isinstance(value, tuple) else str(value)
            shown = shown.lower() if isinstance(value, bool) else shown  # as TOML writes it
            assert described[key] == shown, f"measure.{name}.{key}"


def test_every_key_of_a_sidecar_is_described(root):
    text = page(root, "protocol")
    known = {*sidecar.LAYOUT_KEYS, *sidecar.ROW_KEYS, *sidecar.FrameMetadata.__dataclass_fields__}
    assert [key for key in sorted(known) if f"`{key}`" not in text] == []


def test_map_layers_flags_and_lens_models_are_described(root):
    text = page(root, "map-file")
    assert [name for name in IMAGE_LAYERS if f"`{name.upper()}`" not in text] == []
    for bit, (flag, value) in enumerate(DEFECT_FLAGS.items()):
        assert f"| {bit} | {flag} | {value} |" in text
    conventions = page(root, "conventions")
    for model, terms in DISTORTION_NAMES.items():
        assert f"| `{model}` | {', '.join(terms) or 'none'} |" in conventions


def test_readme_has_the_two_commands_and_a_picture(root):
    text = (root / "README.md").read_text(encoding="utf-8")
    assert "make demo" in text and "make test" in text
    assert re.search(r"!\[[^]]+\]\(docs/pictures/\w+\.png\)", text)


def test_changelog_speaks_of_this_version(root):
    assert f"## {calibench.__version__}" in (root / "CHANGELOG.md").read_text(encoding="utf-8")


def anchors(file: Path) -> set[str]:
    heads = re.findall(r"^#+ (.+)$", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_no_link_is_dead(root):
    dead = []
    for file in pages(root):
        for target in re.findall(r"\]\(([^)\s]+)\)", file.read_text(encoding="utf-8")):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = target.partition("#")
            there = (file.parent / path).resolve() if path else file
            if not there.exists() or (anchor and there.suffix == ".md" and anchor not in anchors(there)):
                dead.append(f"{file.relative_to(root)}: {target}")
    assert dead == []


def test_every_page_and_picture_is_reached_from_the_readme(root):
    seen, todo = set(), [root / "README.md"]
    while todo:
        file = todo.pop()
        if file in seen:
            continue
        seen.add(file)
        if file.suffix == ".md":
            links = re.findall(r"\]\(([^)\s#]+)", file.read_text(encoding="utf-8"))
            todo += [(file.parent / link).resolve() for link in links if not re.match(r"[a-z]+:", link)]
    pictures = list((root / "docs" / "pictures").glob("*.png"))
    assert [str(f.relative_to(root)) for f in [*pages(root), *pictures] if f not in seen] == []
    assert all(picture.stat().st_size <= LARGEST_PICTURE_BYTES for picture in pictures)
