"""Every warning ends in something to do: the sentences of each function that makes one name an action, or ask which."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import onebend
from onebend.report.sentences import SENTENCES

SOURCE = Path(onebend.__file__).parent
ACTION = re.compile(
    r"\?|\b(add|calibrate|check|correct|exchange|film|fix|give|glue|hold|learn|let|log|look|make|measure|push|put|record|start|state|take|"
    r"use|weigh|write)\b",
    re.IGNORECASE,
)


def test_every_warning_names_what_to_do() -> None:
    makers = {
        (str(path.relative_to(SOURCE)), name): text for path in SOURCE.rglob("*.py") for name, text in warnings_of(path)
    }
    assert len(makers) > 20
    assert [key for key, text in makers.items() if not ACTION.search(text)] == []


def test_every_warning_on_what_was_learned_names_what_to_do() -> None:
    """A cause does so in its remedy, and the verdict in its line *next*; a rest that was not seen only says so."""
    others = ("verdict", "known", "more", "rest not seen")
    warnings = {code: one for code, one in SENTENCES.items() if one.about and not code.startswith(others)}
    assert len(warnings) > 50
    assert [code for code, one in warnings.items() if not ACTION.search(one.do or one.text)] == []


def warnings_of(path: Path) -> list[tuple[str, str]]:
    """The functions that make a warning, and all that they and the functions they call in the same file may say."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text if "Remark" in text else "")
    every = [one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef)]
    inner = {id(node) for one in every for node in ast.walk(one) if node is not one}
    functions = [one for one in every if id(one) not in inner]
    said = {one.name: _sentences(one) for one in functions}
    return [
        (one.name, " ".join([_sentences(one), *(said.get(called, "") for called in _called(one))]))
        for one in functions
        if any(_is_warning(node) for node in ast.walk(one))
    ]


def _called(function: ast.FunctionDef) -> set[str]:
    calls = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
    return {one.id for one in calls if isinstance(one, ast.Name)}


def _is_warning(node: ast.AST) -> bool:
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Remark" and node.args):
        return False
    return any(isinstance(part, ast.Constant) and part.value == "warning" for part in ast.walk(node.args[0]))


def _sentences(function: ast.FunctionDef) -> str:
    parts = [
        node.value for node in ast.walk(function) if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    return " ".join(part for part in parts if part != ast.get_docstring(function, clean=False))
