"""What a recording says against k(s), in the words of its remarks."""

from __future__ import annotations

from dataclasses import replace

from onebend.learning.optimizer import doubts_of
from onebend.records import Observations, Remark
from tests.made_up import observations


def saying(*remarks: Remark) -> Observations:
    one = observations()
    return replace(one, source=replace(one.source, remarks=remarks))


def test_a_doubt_is_told_by_what_it_is_about() -> None:
    tool = Remark("warning", "the tool", doubt=True, about="tool place")
    axes = Remark("warning", "the axes", doubt=True, about="axes")
    assert doubts_of(saying()) == ()
    assert doubts_of(saying(replace(tool, doubt=False))) == ()
    assert doubts_of(saying(tool, axes, tool)) == (
        "the film shows the tool elsewhere",
        "the force contradicts the bending",
    )
