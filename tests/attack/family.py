"""Families of attacks: cases with what must come of them, and which of them every run of the tests makes."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.attack.victim import Outcome

Harm = Callable[[Path], object]  # what is done to a folder
LONGEST_MESSAGE = 4000  # characters: more is no message


@dataclass(frozen=True)
class Case:
    """One attack: what is done to a sound folder, and words of the one message that must come of it."""

    name: str
    harm: Harm
    words: str = ""  # a regular expression; empty: any clear refusal will do
    passes: bool = False  # it is harmless, and must be read as if nothing were


def params(cases: Collection[Case], quick: Collection[str]) -> list[Any]:
    """The cases for pytest; those that are not `quick` are slow."""
    names = [case.name for case in cases]
    assert len(set(names)) == len(names)
    assert set(quick) <= set(names), set(quick) - set(names)
    return [pytest.param(case, id=case.name, marks=() if case.name in quick else pytest.mark.slow) for case in cases]


def withstood(outcome: Outcome, case: Case, *, seconds: float = 20.0, most_MB: float = 1000.0) -> None:
    """The program ended by itself, after little work and within its memory, with one message; or it did its work."""
    assert outcome.verdict == ("done" if case.passes else "refused"), (outcome.verdict, outcome.err[-2000:])
    assert outcome.work_s < seconds
    assert outcome.peak_MB < most_MB
    assert len(outcome.err) < LONGEST_MESSAGE
    assert "\x1b" not in outcome.err
    if not case.passes:
        assert re.search(case.words, " ".join(outcome.err.split())), outcome.err


def edit(file: str, old: str, new: str) -> Harm:
    """Replace the first `old` in a file of the folder."""

    def harm(folder: Path) -> None:
        path = folder / file
        text = path.read_text(encoding="utf-8")
        assert old in text, old
        path.write_text(text.replace(old, new, 1), encoding="utf-8")

    return harm


def rewrite(file: str, change: Callable[[str], str | bytes]) -> Harm:
    """Write a file of the folder anew, from its text."""

    def harm(folder: Path) -> None:
        path = folder / file
        changed = change(path.read_text(encoding="utf-8"))
        path.write_bytes(changed if isinstance(changed, bytes) else changed.encode("utf-8"))

    return harm


def written(file: str, content: str | bytes) -> Harm:
    """Write this into a file of the folder."""
    data = content if isinstance(content, bytes) else content.encode("utf-8")
    return lambda folder: (folder / file).write_bytes(data)


def sparse(file: str, size: int) -> Harm:
    """Lengthen a file to `size` bytes that take no place on the disk."""

    def harm(folder: Path) -> None:
        with (folder / file).open("r+b") as stream:
            stream.truncate(size)

    return harm
