"""rosbags reads files, types and messages of bags."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[3]
DOCUMENTED = {"interfaces", "interfaces.typing", "rosbag1", "rosbag2", "serde", "typesys", "typesys.store"}


def test_only_documented_modules_of_rosbags_are_imported() -> None:
    modules = set()
    for path in (ROOT / "src").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text if "rosbags" in text else "")):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules |= {name.removeprefix("rosbags.") for name in names if name.startswith("rosbags.")}
    assert modules <= DOCUMENTED
