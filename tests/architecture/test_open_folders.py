"""The contract of the open folders, over every name that is registered: one new file is the whole change."""

from __future__ import annotations

import inspect
import re

import pytest

from calibench import registry
from calibench.errors import UsageError

# Open folder -> what each of its modules offers: a function by its first parameters, or a value of a type.
CONTRACTS: dict[str, dict[str, tuple[str, ...] | type]] = {
    "calibench.measure": {"measure": ("frames", "settings", "calmap"), "Settings": type},
    "calibench.measure.corners": {"find": ("grey", "target"), "points": ("board",),
                                  "shown": ("grey", "target"), "TARGET": str, "POINT": str,
                                  "WINDOWS": tuple},
    "calibench.spots.detect": {"detect": ("signal_dn", "noise_dn", "unusable", "sensitivity")},
    "calibench.spots.centroid": {"centroid": ("scene", "candidates")},
    "calibench.stars.identify": {"table_key": ("view",), "build": ("sky", "key"),
                                  "propose": ("view", "sky", "table"), "NEEDS_SCALE": bool, "Table": type},
    "calibench.stars.attitude": {"attitude": ("camera", "sky", "weights"), "effective_weights": ("camera", "weights")},
    "calibench.validate.trials": {"trial": ("cases", "calmap")},
    "calibench.io.readers": {"read": ("raw", "file", "sidecar")},
    "calibench.io.exports": {"export": ("calmap", "path")},
    "calibench.io.imports": {"read": ("path",)},
    "calibench.report.sections": {"render": ("story",), "ORDER": int, "TITLE": str},
}
REGISTERED = [(folder, name) for folder in CONTRACTS for name in registry.names(folder)]


@pytest.mark.parametrize(("folder", "name"), REGISTERED)
def test_each_choice_keeps_the_contract(folder, name):
    module = registry.load(folder, name)
    assert module.__doc__, f"{folder}.{name} does not say what it is"
    for offer, wanted in CONTRACTS[folder].items():
        found = getattr(module, offer, None)
        if isinstance(wanted, type):
            assert isinstance(found, wanted), f"{folder}.{name} has no {wanted.__name__} {offer}"
        else:
            assert callable(found), f"{folder}.{name} has no {offer}()"
            assert tuple(inspect.signature(found).parameters)[:len(wanted)] == wanted


def test_no_open_folder_is_forgotten(root):
    """A package that calls itself an open folder, and every one that the registry is asked for, has its contract."""
    package = root / "calibench"
    said = {".".join(file.parent.relative_to(root).parts) for file in package.rglob("__init__.py")
            if "open folder" in file.read_text(encoding="utf-8").lower()}
    named = {text for file in package.rglob("*.py")
             for text in re.findall(r'(?:registry\.\w+\(|^[A-Z]+ = )"(calibench(?:\.\w+)+)"',
                                    file.read_text(encoding="utf-8"), re.MULTILINE)}
    assert {"calibench.spots.detect", "calibench.io.readers"} <= named  # so that finding nothing is not a pass
    assert (said - {"calibench.records"}) | named <= CONTRACTS.keys()


@pytest.mark.parametrize("folder", CONTRACTS)
def test_an_unknown_name_answers_with_the_known_ones(folder):
    with pytest.raises(UsageError, match="no_such_choice") as caught:
        registry.load(folder, "no_such_choice")
    assert all(name in str(caught.value) for name in registry.names(folder))
    assert caught.value.exit_code == 2


def test_a_folder_inside_an_open_folder_is_no_choice_of_it():
    assert "corners" not in registry.names("calibench.measure")
    with pytest.raises(UsageError):
        registry.load("calibench.measure", "corners")


@pytest.mark.parametrize("name", ["_hidden", "kernels", "..errors", "", "__init__"])
def test_what_is_no_choice_cannot_be_loaded(name):
    with pytest.raises(UsageError):
        registry.load("calibench.io.exports", name)
