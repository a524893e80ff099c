"""Layers import downwards only, wings are unknown to the core, and no module imports itself by way of others."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

from onebend.wings import WINGS

PACKAGE = Path(__file__).parents[1] / "src" / "onebend"

# From the lowest up. A name is a folder of the package, or a module.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("errors", "options", "progress", "wings"),
    ("extras", "record_data", "records", "text_files"),
    ("beam", "crash", "files", "gauss_newton"),
    ("recording", "control"),
    ("learning",),
    ("report", "export"),
    ("results",),
    ("pipeline",),
    ("__init__",),
    ("cli",),
    ("__main__",),
    ("live", "many", "lab"),
    ("drive",),
    ("studio",),
)
STRANGERS = {("recording", "beam")}  # the first stands above the second and does not import it either
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}


@cache
def imported_modules(path: Path) -> list[tuple[int, str]]:
    """Line and dotted name of everything of onebend that the file imports, lazily too."""
    modules: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are absolute here"
            names = [f"{node.module}.{alias.name}" for alias in node.names]  # a module, or a name in one
        else:
            continue
        modules += [(node.lineno, name) for name in names if name.split(".")[0] == "onebend"]
    return modules


def breaches(package: Path) -> list[str]:
    """Every import between layers that goes up or sideways, as `file:line: a -> b`."""
    wrong: list[str] = []
    for path in sorted(package.rglob("*.py")):
        here = path.relative_to(package).with_suffix("").parts[0]
        if here not in LEVEL:
            wrong.append(f"{path}: '{here}' stands in no layer; add it to LAYERS")
            continue
        for line, module in imported_modules(path):
            there = (module.split(".")[1:] or ["__init__"])[0]
            if there == here:
                continue
            if LEVEL.get(there, LEVEL["__init__"]) >= LEVEL[here] or (here, there) in STRANGERS:
                wrong.append(f"{path}:{line}: {here} -> {there}")
    return wrong


def circles(package: Path) -> list[str]:
    """Modules that import themselves by way of others."""
    paths = {".".join(("onebend", *p.relative_to(package).with_suffix("").parts)): p for p in package.rglob("*.py")}
    needs = {}
    for name, path in paths.items():
        imported = {module for _, module in imported_modules(path)}
        needs[name] = (imported | {module.rpartition(".")[0] for module in imported}) & set(paths)
    while free := [name for name, needed in needs.items() if not needed & set(needs)]:
        for name in free:
            del needs[name]
    return sorted(needs)


def test_layers_import_downwards_only() -> None:
    assert breaches(PACKAGE) == []


def test_no_module_imports_itself_by_way_of_others() -> None:
    assert circles(PACKAGE) == []


def test_wings_stand_above_the_core() -> None:
    """With the rule of layers this says that the core imports no wing."""
    assert min(LEVEL[wing] for wing in WINGS) > max(LEVEL[name] for name in LEVEL if name not in WINGS)


@pytest.mark.parametrize(
    ("member", "line"),
    [
        ("beam", "from onebend.recording.force import find_contact"),
        ("beam", "import onebend"),
        ("recording", "from onebend.beam.statics import newton"),
        ("control", "from onebend import recording"),
        ("learning", "from onebend import pipeline"),
        ("report", "def lazy():\n    from onebend.cli import main"),
        ("results", "from onebend.lab import virtual"),
        ("lab", "from onebend.live.session import record"),
        ("live", "from onebend.drive.robots import Robot"),
        ("cellar", "import math"),
    ],
)
def test_planted_breach_is_found(tmp_path: Path, member: str, line: str) -> None:
    (tmp_path / member).mkdir(parents=True)
    (tmp_path / member / "planted.py").write_text(line + "\n", encoding="utf-8")
    assert len(breaches(tmp_path)) == 1


def test_planted_circle_is_found(tmp_path: Path) -> None:
    (tmp_path / "beam").mkdir(parents=True)
    (tmp_path / "beam" / "one.py").write_text("from onebend.beam.other import x\n")
    (tmp_path / "beam" / "other.py").write_text("from onebend.beam import one\n")
    assert circles(tmp_path) == ["onebend.beam.one", "onebend.beam.other"]
