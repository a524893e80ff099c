"""The sentences of what was learned: each code has one, each sentence is used, and units convert."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from string import Formatter
from typing import get_args

import numpy as np
import pytest

import onebend
from onebend.errors import sections
from onebend.learning.outcome import Notice
from onebend.records import MassAlong, Remark
from onebend.report.sentences import SENTENCES, odds, remedy, say, worded, words
from tests.lab.core.test_criticism import suspects

PARTS = (" backwards", ": longer", ": shorter", ": unknown", ": far", ": x", ": y", " a section")  # of causes
MASSES = {
    f"mass: {'' if written else 'not '}written, {'' if learned else 'not '}learned{', spread' if spread else ''}"
    for written in (True, False)
    for learned in (True, False)
    for spread in (True, False)
} | {f"spread: {along}" for along in get_args(MassAlong) if along != "unknown"}
ENDS = ("", " in poses", " by another beam", " by another beam in poses")  # of a missed tag


def codes_in_the_package() -> set[str]:
    """All that the code gives to `Notice` and `say` as a code."""
    found = set()
    for path in Path(onebend.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text if re.search(r"\b(Notice|say)\(", text) else "")):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("Notice", "say"):
                ways = [one for one in node.args[:1] if not isinstance(one, ast.JoinedStr)]
                ends = [
                    part for one in ways for part in ([one.body, one.orelse] if isinstance(one, ast.IfExp) else [one])
                ]
                found |= {str(one.value) for one in ends if isinstance(one, ast.Constant)}
    return found


def test_every_code_has_a_sentence() -> None:
    assert codes_in_the_package() - SENTENCES.keys() == set()
    assert {f"tag missed{end}" for end in ENDS} | MASSES < SENTENCES.keys()
    assert {one.name for one in suspects() if one.kind != "trend"} - SENTENCES.keys() == {"length"}
    assert {one.about for one in SENTENCES.values()} - {""} < sections().keys()


def test_every_sentence_is_said_somewhere() -> None:
    source = "".join(path.read_text(encoding="utf-8") for path in Path(onebend.__file__).parent.rglob("*.py"))
    causes = {one.name + part for one in suspects() for part in ("", *PARTS)}
    composed = {*causes, *MASSES, *(f"tag missed{end}" for end in ENDS)}
    assert [code for code in SENTENCES if f'"{code}"' not in source and code not in composed] == []


@pytest.mark.parametrize("code", SENTENCES)
def test_every_template_can_be_filled(code: str) -> None:
    one = SENTENCES[code]
    for text in (one.text, one.do, one.do_for_poses, one.do_without_camera):
        for _, name, spec, conversion in Formatter().parse(text):
            assert name is None or (all(map(str.isidentifier, name.split("."))) and not conversion), text
            assert spec is None or "{" not in spec


def test_numbers_are_shown_in_the_unit_of_their_field() -> None:
    assert say("loose", tag=3, moved=1.234e-3) == "tag 3 moved on the beam by 1.2 mm"
    assert say("loose", tag=3, moved=0.5512).endswith("550 mm")
    assert say("turn", tag=1, size=np.deg2rad(2.5)) == "tag 1 is turned by 2.5 deg"
    assert say("clock", size=0.0123) == "the clocks are off by 12 ms"
    assert "about s = 0.8," in say("push elsewhere", where=(0.8, 0.801), written=0.9)
    assert "between s = 0.7 and 0.8," in say("push elsewhere", where=(0.7, 0.8), written=0.9)
    assert [odds(-2.5), odds(-5.0), odds(-99.0)] == ["1 in 320", "1 in 100 000", "1 in 1 000 000 000 or less"]


def test_g_is_grams_and_no_form_of_a_number() -> None:
    after = {code: re.findall(r"\{[^}:]*:g\}(.{0,3})", one.text) for code, one in SENTENCES.items()}
    assert {code: found for code, found in after.items() if any(not re.match(r" g\b", text) for text in found)} == {}
    assert say("recorded: short rest", wanted=3.0).startswith("the first rest was shorter than 3 s")


def test_poses_and_films_have_their_own_remedies() -> None:
    film = {"static": False, "filmed": True}
    assert remedy(Notice("scale", film)) == "Calibrate the camera; check size_m"
    assert remedy(Notice("scale", {"static": False, "filmed": False})).startswith("Check the unit")
    assert "clamp_deg and base_angle_deg" in remedy(Notice("clamp", {"static": True, "filmed": False}))
    assert "wrong by +5.7" in remedy(Notice("force direction", film | {"value": 0.1}))


def test_only_a_sentence_with_an_entry_is_a_warning() -> None:
    other = Remark("note", "as it is")
    snaps, far, same = worded(
        (Notice("snaps", {"lost": 1, "frames": 9}), Notice("pose left out", {"names": "up"}, "second"), other)
    )
    assert (snaps.level, snaps.about, far.level, far.about) == ("warning", "no equilibrium", "note", "")
    assert far.text.startswith("second: pose up was left out")
    assert same is other
    assert words(Notice("slight", {"what": Notice("viscous")})).startswith("the shape lags behind the force: more")
