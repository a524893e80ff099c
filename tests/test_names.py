"""A class name means one thing: no two classes of the package share it."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src" / "onebend"


def shared_names(folder: Path) -> dict[str, list[str]]:
    """Names of the classes below `folder` that more than one module defines, with those modules."""
    modules = defaultdict(list)
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                modules[node.name].append(path.relative_to(folder).as_posix())
    return {name: where for name, where in modules.items() if len(where) > 1}


def test_no_two_classes_share_a_name() -> None:
    shared = shared_names(SOURCE)
    assert not shared, f"give each of these classes a name of its own: {shared}"


def test_a_shared_name_is_found(tmp_path: Path) -> None:
    (tmp_path / "room").mkdir()
    (tmp_path / "a.py").write_text("class Push: ...\nclass Grip: ...\n", encoding="utf-8")
    (tmp_path / "room" / "b.py").write_text("def make():\n    class Push: ...\n", encoding="utf-8")
    assert shared_names(tmp_path) == {"Push": ["a.py", "room/b.py"]}
