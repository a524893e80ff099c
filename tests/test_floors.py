"""Layers import downwards only; folders on one floor do not know each other."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "src" / "onebend"

FLOORS: tuple[tuple[str, ...], ...] = (
    ("errors", "progress", "blas", "workers", "strict_json"),
    ("records",),
    ("beam",),
    ("recording",),
    ("learning", "control", "lab"),
    ("report", "export", "estimators"),
    ("results",),
    ("pipeline", "rehearse"),
    ("reproduce",),
    ("terminal",),
    ("__init__",),
    ("cli",),
    ("__main__",),
)
LEVEL = {name: level for level, names in enumerate(FLOORS) for name in names}
# One floor in the plan, but listed apart above so that neither may import the other.
STRANGERS = {("recording", "beam")}


def room(path: Path, package: Path) -> str:
    """The floor's member a file belongs to: its folder, or its own name at the top."""
    parts = path.relative_to(package).parts
    return parts[0] if len(parts) > 1 else path.stem


def imported_rooms(path: Path) -> list[tuple[int, str]]:
    """Line and member of every import of onebend in the file, lazy ones included."""
    found: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: imports are absolute here"
            base = node.module or ""
            modules = [f"onebend.{alias.name}" for alias in node.names] if base == "onebend" else [base]
        else:
            continue
        for module in modules:
            parts = module.split(".")
            if parts[0] == "onebend":
                found.append((node.lineno, parts[1] if len(parts) > 1 else "__init__"))
    return found


def breaches(package: Path) -> list[str]:
    """Every import that goes up or sideways, as `file:line: a -> b`."""
    wrong: list[str] = []
    for path in sorted(package.rglob("*.py")):
        here = room(path, package)
        if here not in LEVEL:
            wrong.append(f"{path}: '{here}' stands on no floor; add it to FLOORS")
            continue
        for line, there in imported_rooms(path):
            if there == here:
                continue
            known = there in LEVEL
            if not known or LEVEL[there] >= LEVEL[here] or (here, there) in STRANGERS:
                wrong.append(f"{path}:{line}: {here} -> {there}")
    return wrong


def test_layers_import_downwards_only() -> None:
    assert breaches(PACKAGE) == []


@pytest.mark.parametrize(
    ("member", "line"),
    [
        ("beam", "from onebend.recording import force"),
        ("beam", "import onebend"),
        ("recording", "from onebend.beam import statics"),
        ("learning", "from onebend.control import reach"),
        ("learning", "from onebend import pipeline"),
        ("report", "def lazy():\n    from onebend.cli import main"),
    ],
)
def test_planted_breach_is_found(tmp_path: Path, member: str, line: str) -> None:
    (tmp_path / member).mkdir()
    (tmp_path / member / "planted.py").write_text(line + "\n", encoding="utf-8")
    assert len(breaches(tmp_path)) == 1
