"""The pages on the code name the layers, modules, functions and tests that exist."""

from __future__ import annotations

import re
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest

from tests.test_layers import LAYERS, PACKAGE

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
QUOTED = re.compile(r"`([^`\n]+)`")
EQUATIONS = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
OUR_OWN = ("architecture.md", "contributing.md", "equations.md", "glossary.md")  # where a name begins with its layer
TOP = {path.stem for path in PACKAGE.iterdir()} - {"__init__", "__main__", "__pycache__"}


def section(title: str) -> str:
    """The page from a title to the next of the same or a higher level."""
    level = title.split(" ")[0]
    rest = PAGE.split(f"\n{title}\n", 1)[1]
    return re.split(rf"(?m)^#{{1,{len(level)}}} ", rest)[0]


def rows(text: str) -> list[list[str]]:
    """The cells of the tables in a text, without their heads."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [
        row
        for row, after in zip(cells, [*cells[1:], [""]], strict=True)
        if "---" not in row[0] and "---" not in after[0]
    ]


def floors(text: str) -> list[set[str]]:
    """The names in the second column of a table, floor by floor."""
    return [
        {name for row in same for name in QUOTED.findall(row[1])} for _, same in groupby(rows(text), lambda row: row[0])
    ]


def resolve(name: str) -> Any:
    """The object of a dotted name that begins with a layer."""
    parts = ["onebend", *name.removeprefix("onebend.").split(".")]
    for count in range(len(parts), 0, -1):
        try:
            found = import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            found = getattr(found, part)
        return found
    raise ModuleNotFoundError(name)


def test_layers_are_those_that_the_test_of_layers_knows() -> None:
    assert floors(section("## Layers")) == [set(layer) for layer in LAYERS]


def test_every_equation_has_a_function_and_a_test() -> None:
    table = rows(EQUATIONS)
    assert {f"({i})" for i in range(1, 26)} <= {one for row in table for one in equations(row[0])}
    for what, function, test in table:
        [name], [place] = QUOTED.findall(function), QUOTED.findall(test)
        assert resolve(name) is not None, what
        file, _, wanted = place.partition("::")
        text = (ROOT / "tests" / file).read_text(encoding="utf-8")
        assert not wanted or f"def {wanted}(" in text, f"{what}: {place}"


def equations(text: str) -> list[str]:
    """The equation numbers that a cell names, ranges written out."""
    out = []
    for first, last in re.findall(r"\((\d+)\)(?:-\((\d+)\))?", text):
        out += [f"({i})" for i in range(int(first), int(last or first) + 1)]
    return out


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_names_of_modules_and_files_are_real(page: Path) -> None:
    for quoted in QUOTED.findall(page.read_text(encoding="utf-8")):
        if re.fullmatch(r"[a-z_]+(\.\w+)+", quoted) and quoted.split(".")[0] in {"onebend", *TOP}:
            if quoted.endswith((".py", ".toml", ".md", ".json", ".html", ".png")):
                continue
            if page.name not in OUR_OWN and not quoted.startswith("onebend."):
                continue
            resolve(quoted)
        elif re.fullmatch(r"[\w/]+/\w+\.py", quoted):
            assert any((ROOT / base / quoted).is_file() for base in ("", "src/onebend", "tests")), quoted
