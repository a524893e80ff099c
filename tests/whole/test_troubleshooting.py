"""Every warning says what it is about, docs/troubleshooting.md has a section for it, and no section is without one."""

from __future__ import annotations

import ast
import io
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from onebend.cli import app
from onebend.cli.common import remarks_list
from onebend.crash import clean_errors
from onebend.errors import ObservationError, reference, section, sections, told
from onebend.learning.criticism import Criticism, Finding, Score, Suspect
from onebend.learning.verdict import criticism_notices, fit_notices
from onebend.records import Remark
from onebend.report.page import page
from onebend.report.sentences import SENTENCES, worded
from onebend.report.verdict import verdict_of
from onebend.results.model import save_model
from tests import made_up
from tests.lab.core.test_criticism import suspects

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "onebend"
TEXT = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
BY_HAND = {"Remark", "say_warning"}  # what makes a warning; errors say it where they have a section


def anchors(text: str) -> list[str]:
    """Of the sections of a page, as Markdown viewers make them of their titles."""
    titles = re.findall(r"(?m)^### (.+)$", text)
    return [re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles]


@cache
def nodes_of(path: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def calls() -> Iterator[tuple[str, ast.Call]]:
    """Where and what of every call in the package of something that makes a warning, or that says its `about`."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in nodes_of(path):
            if isinstance(node, ast.Call):
                yield f"{path.relative_to(PACKAGE)}:{node.lineno}", node


def about_of(call: ast.Call) -> ast.expr | None:
    return next((word.value for word in call.keywords if word.arg == "about"), None)


def warns(call: ast.Call) -> bool:
    """Whether the call can make a warning: a `Remark` that is not a note throughout, a warning of a command."""
    name = call.func.id if isinstance(call.func, ast.Name) else ""
    if name not in BY_HAND:
        return False
    level = call.args[0] if call.args else None
    return name != "Remark" or not (isinstance(level, ast.Constant) and level.value == "note")


def named() -> set[str]:
    """All that the code's warnings and errors are about, and the sentences of what learning found."""
    found = {one.about for one in SENTENCES.values()}
    for _, call in calls():
        if isinstance(about := about_of(call), ast.Constant):
            found.add(str(about.value))
    return found - {""}


def test_every_warning_says_what_it_is_about() -> None:
    """A new warning: `about="..."` with a key of `sections.toml`, and its section on the page."""
    copied = "results/detection_cache.py"  # which reads warnings back as they were
    silent = [
        where for where, call in calls() if warns(call) and about_of(call) is None and not where.startswith(copied)
    ]
    assert silent == []


def test_what_warnings_are_about_is_what_has_a_section() -> None:
    assert named() == set(sections())


def test_every_section_is_named_by_a_warning_and_every_warning_has_its_section() -> None:
    there = anchors(TEXT)
    assert len(set(there)) == len(there)
    assert set(there) == set(sections().values())
    form = re.compile(r"[^\n]+\n\n\*\*Cause\.\*\* .+\n\n\*\*Remedy\.\*\* .+", re.DOTALL)
    assert [one for one in re.split(r"(?m)^### ", TEXT)[1:] if form.match(one) is None] == []
    for inside in re.findall(r"\]\(#([^)]+)\)", TEXT):
        assert inside in there


def test_planted_faults_are_noticed() -> None:
    assert anchors("### k(s) is NOT TO BE TRUSTED\n\n## no\n\n### A tag's place, s") == [
        "ks-is-not-to-be-trusted",
        "a-tags-place-s",
    ]
    call = ast.parse('Remark("warning" if often else "note", text)').body[0]
    assert isinstance(call, ast.Expr)
    assert isinstance(call.value, ast.Call)
    assert warns(call.value)
    assert about_of(call.value) is None


@pytest.mark.parametrize("suspect", suspects(), ids=lambda one: f"{one.kind} {one.name}")
def test_a_warning_of_the_models_tests_is_about_its_likeliest_cause(suspect: Suspect) -> None:
    finding = Finding(Score(suspect, np.full(3, 2e-3), np.ones(3), 50.0, -9.0, 1e-3, np.zeros(8)), 0.1, 2.0)
    one = replace(made_up.posterior(), criticism=Criticism((finding,)))
    [warning] = [one for one in worded(criticism_notices(one)) if one.level == "warning"]
    assert warning.about == ("unexplained" if suspect.kind == "trend" else suspect.name)
    assert warning.docs == f"troubleshooting.md#{sections()[warning.about]}"


WARNING = Remark("warning", "the film hung for 2 s", about="film hung")
NOTE = Remark("note", "3 of 9000 rows hold no number", about="bad rows")
REFERENCE = "docs: troubleshooting.md#the-film-hung"


def test_a_warning_says_where_to_read_of_it_and_a_note_does_not() -> None:
    assert WARNING.as_dict() == {"level": "warning", "text": WARNING.text, "docs": "troubleshooting.md#the-film-hung"}
    assert NOTE.as_dict() == {"level": "note", "text": NOTE.text}
    assert reference("film hung") == REFERENCE
    assert reference("") == section("") == ""
    both = [("train", WARNING), ("train", NOTE)]
    for drawn in (remarks_list(both[:1]), remarks_list(both)):
        console = Console(file=io.StringIO(), width=80)
        console.print(drawn)
        text = console.file.getvalue()  # type: ignore[attr-defined]
        assert text.count("docs: ") == 1
        assert REFERENCE in text
        assert text.index(WARNING.text) < text.index(REFERENCE)


def test_the_report_says_it_too() -> None:
    found = replace(made_up.findings(0), remarks=(WARNING, NOTE))
    text = page(found, {})
    assert text.count(REFERENCE) == 2  # above, and among all remarks
    assert "rows-or-pictures" not in text


def test_an_error_that_has_a_section_names_it(capsys: pytest.CaptureFixture[str]) -> None:
    error = ObservationError("no tag is in the film", about="unseen tag")
    assert told(error).splitlines() == ["no tag is in the film", "docs: troubleshooting.md#a-tag-is-never-seen"]
    assert told(ObservationError("no push")) == "no push"
    with pytest.raises(SystemExit), clean_errors():
        raise error
    said = capsys.readouterr().err.splitlines()
    assert said == ["onebend: no tag is in the film.", "docs: troubleshooting.md#a-tag-is-never-seen"]


def test_the_verdict_names_the_section_of_what_is_wrong_with_k() -> None:
    good = made_up.findings(0)
    assert verdict_of(good).about == ""
    assert dict(verdict_of(good).rows).get("docs") is None
    assert good.posterior is not None
    stopped = replace(good.posterior, optimum=replace(good.posterior.optimum, converged=False))
    doubted = verdict_of(replace(good, posterior=stopped))
    assert dict(doubted.rows)["docs"] == doubted.as_dict()["docs"] == section("not trusted")
    assert [one.about for one in worded(fit_notices(stopped)) if one.level == "warning"] == ["not converged"]


def test_a_command_warns_of_a_model_in_doubt_with_the_section(tmp_path: Path) -> None:
    found = made_up.posterior()
    save_model(
        tmp_path / "model.json",
        found.beam,
        written_by="a test",
        uncertain=replace(found.stiffness, doubts=("the fit did not converge",)),
    )
    said = CliRunner().invoke(app, ["reach", str(tmp_path), "--goal", "0.14", "0.02"])
    assert "NOT TO BE TRUSTED: the fit did not converge.\ndocs: troubleshooting.md#ks-is-not" in said.stderr
