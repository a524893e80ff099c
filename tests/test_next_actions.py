"""Every warning ends in something to do: the sentences of each function that makes one name an action, or ask which."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import onebend

SOURCE = Path(onebend.__file__).parent
ACTION = re.compile(
    r"\?|\b(add|check|correct|exchange|film|fix|give|glue|hold|learn|let|log|look|make|measure|push|put|record|start|state|take|"
    r"weigh|write)\b",
    re.IGNORECASE,
)
ELSEWHERE = {  # whose words, or whose action, stand in the function beside them
    ("learning/verdict.py", "fit_remarks"): "_first_check",
}


def test_every_warning_names_what_to_do() -> None:
    makers = {
        (str(path.relative_to(SOURCE)), name): text for path in SOURCE.rglob("*.py") for name, text in warnings_of(path)
    }
    assert len(makers) > 30
    told = {key for key, text in makers.items() if ACTION.search(text)}
    assert makers.keys() - told == ELSEWHERE.keys()


def warnings_of(path: Path) -> list[tuple[str, str]]:
    """The functions that make a warning, and all that they may say."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = [one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef)]
    return [(one.name, _sentences(one)) for one in functions if any(_is_warning(node) for node in ast.walk(one))]


def _is_warning(node: ast.AST) -> bool:
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Remark" and node.args):
        return False
    return any(isinstance(part, ast.Constant) and part.value == "warning" for part in ast.walk(node.args[0]))


def _sentences(function: ast.FunctionDef) -> str:
    parts = [
        node.value for node in ast.walk(function) if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    return " ".join(part for part in parts if part != ast.get_docstring(function, clean=False))
