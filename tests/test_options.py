"""Options from the fields of settings: names, units, ranges and defaults stand in the dataclass alone."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from typer.testing import CliRunner

import onebend
from benchmarks.pages import options_of
from onebend.cli import Command, all_commands
from onebend.options import POSITIVE, Only, expanded, helps, option
from onebend.wings import WINGS


@dataclass(frozen=True)
class Inner:
    angle: float = option("--angle-deg", math.radians(30.0), "An angle.", metavar="DEG", within=(0.0, 90.0))
    limit: float = option("--limit-N", math.inf, "A limit; default: none.", metavar="N", within=POSITIVE)


@dataclass(frozen=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    places: tuple[float, ...] = option("--at", (1.0,), "Places.", metavar="S")
    filmed: bool = option("--unfilmed", True, "No film.")
    loud: bool = option("--loud", False, "Loud.")
    length: float | None = option("--length-mm", None, "A length.", metavar="MM")
    hidden: int = 7


def answer(*words: str, kind: Any = Outer) -> Any:
    """What a command with these settings is given, or its message where it refuses the words."""
    given: list[Any] = []

    def command(*, name: str = "beam", settings: Any) -> None:
        given.append((name, settings))

    command.__annotations__["settings"] = kind
    app = typer.Typer()
    app.command()(expanded(command))
    done = CliRunner().invoke(app, words)
    return given[0] if given else done.output


def test_without_options_the_settings_are_the_defaults() -> None:
    assert answer() == ("beam", Outer())


def test_options_fill_the_fields_in_si_units() -> None:
    name, found = answer(
        *("--name", "rod", "--angle-deg", "60", "--limit-N", "2", "--at", "0.2", "--at", "0.5"),
        *("--unfilmed", "--loud", "--length-mm", "12"),
    )
    assert name == "rod"
    assert found.inner == Inner(math.radians(60.0), 2.0)
    assert found.places == (0.2, 0.5)
    assert (found.filmed, found.loud) == (False, True)
    assert found.length == pytest.approx(0.012)
    assert found.hidden == 7


def test_a_range_is_in_the_option_s_unit() -> None:
    assert "less than or equal to 90" in answer("--angle-deg", "91")
    assert answer("--angle-deg", "90")[1].inner.angle == pytest.approx(0.5 * math.pi)


def test_the_help_shows_the_default_in_the_option_s_unit_and_none_for_what_is_found_later() -> None:
    shown = " ".join(answer("--help").split())
    assert "[default: 30.0]" in shown
    assert "inf" not in shown


def test_a_command_may_take_some_fields_alone() -> None:
    kind = Annotated[Outer, Only(("loud",))]
    assert answer("--loud", kind=kind)[1] == Outer(loud=True)
    assert "No such option" in answer("--unfilmed", kind=kind)


def test_other_parameters_are_options_and_arguments_by_their_names() -> None:
    given: list[Any] = []

    def command(folder: Path, *, most_views: int = 30) -> None:
        given.append((folder, most_views))

    app = typer.Typer()
    app.command()(expanded(command))
    for words in (("here",), ("there", "--most-views", "4")):
        assert CliRunner().invoke(app, words).exit_code == 0
    assert given == [(Path("here"), 30), (Path("there"), 4)]


def test_every_option_has_its_help_and_every_help_its_option() -> None:
    commands = {name: Command(name, place) for name, place in all_commands().items()}
    parameters = {name: options_of(one.function()) for name, one in commands.items()}
    assert [(name, one["name"]) for name, own in parameters.items() for one in own if not one.get("help")] == []
    folder = Path(onebend.__file__).parent
    source = "".join(path.read_text(encoding="utf-8") for path in folder.rglob("*.py"))
    whole = all((folder / wing).is_dir() for wing in WINGS)
    for kind, said in helps().items():
        if kind in commands or kind == "every":
            names = {one["name"] for name in commands if kind in (name, "every") for one in parameters[name]}
            assert said.keys() <= names, kind
            continue
        bodies = re.findall(rf"^class {kind}\b.*?(?=^[^\s])", source, re.MULTILINE | re.DOTALL)
        if bodies or whole:  # else it is of a wing that is left out
            assert re.findall(r' option\("(--[^"]+)"', *bodies) == list(said), kind
