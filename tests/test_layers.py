"""Imports go downwards, and nothing depends on which bonus or prior it was given."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import deep_curiosity
from deep_curiosity.agent.networks import Prior
from deep_curiosity.bonuses import BONUSES, Bonus

ROOT = Path(deep_curiosity.__file__).parent
LAYERS = (
    ("lazy", "requirements", "transitions"),
    ("arguments", "configuration", "schedules", "gaussians", "losses", "nn"),
    ("replay",),
    ("speed",),
    ("bonuses",),
    ("agent",),
    ("speed.numpy_policy",),
    ("training",),
    ("integrations", "tabular", "trained"),
    ("experiments",),
    ("benchmark",),
    ("cli",),
    ("__main__",),
)
"""From the lowest to the highest: what stands in one line does not import one another."""
LEVELS = {name: level for level, names in enumerate(LAYERS) for name in names}


def module_name(path: Path) -> str:
    """Name of a module within the package; empty for the package itself."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(ROOT.rglob("*.py"))}


def imports_of(path: Path) -> Iterator[str]:
    """What a module imports from the package at its top level, by name within the package."""
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            package, _, inner = name.partition(".")
            if package == "deep_curiosity":
                yield inner


def layer_of(name: str) -> str | None:
    """The layer, by its longest name, that a module or something in it belongs to."""
    parts = name.split(".")
    prefixes = [".".join(parts[:length]) for length in range(len(parts), 0, -1)]
    return next((prefix for prefix in prefixes if prefix in LEVELS), None)


def test_every_module_is_in_a_layer():
    others = {name.split(".")[0] for name in MODULES if layer_of(name) is None}
    assert others == {""}  # the package itself


@pytest.mark.parametrize("name", [name for name in MODULES if layer_of(name)])
def test_imports_go_downwards(name):
    own = layer_of(name)
    for imported in imports_of(MODULES[name]):
        if imported == "__version__":
            continue
        other = layer_of(imported)
        assert other is not None, f"{name} imports {imported}, which is in no layer"
        assert other == own or LEVELS[other] < LEVELS[own], (
            f"{name} imports {imported}, which is above it or beside it"
        )


@pytest.mark.parametrize("name", [name for name in MODULES if name.startswith("tabular")])
def test_the_tabular_part_stands_alone(name):
    assert {imported.split(".")[0] for imported in imports_of(MODULES[name])} <= {"tabular"}


def subclasses(kind: type) -> set[str]:
    """Names of all classes below one, however far."""
    below = kind.__subclasses__()
    return {each.__name__ for each in below}.union(*(subclasses(each) for each in below))


def checked_classes(path: Path) -> Iterator[str]:
    """Names of the classes that a module checks for by `isinstance` or `issubclass`."""
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
            continue
        if node.func.id in ("isinstance", "issubclass") and len(node.args) == 2:
            for part in ast.walk(node.args[1]):
                if isinstance(part, ast.Name | ast.Attribute):
                    yield part.id if isinstance(part, ast.Name) else part.attr


@pytest.mark.parametrize("name", MODULES)
def test_no_module_checks_which_bonus_or_prior_it_was_given(name):
    assert len(BONUSES) > 5  # all are loaded
    concrete = {kind for kind in subclasses(Bonus) | subclasses(Prior) if not kind.startswith("_")}
    assert {"CuriosityBonus", "RNDBonus", "LearnedPrior", "UniformPrior"} <= concrete
    assert concrete.isdisjoint(checked_classes(MODULES[name]))
