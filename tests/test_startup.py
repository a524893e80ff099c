"""What is loaded when, without a clock; `python -m benchmarks.startup` measures the times."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from inspect import isfunction, signature
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.pages import options_of
from onebend.cli import OPTIONS, Command, all_commands, app, function_of
from onebend.results.model import save_model
from tests import made_up

COMMANDS = all_commands()

HEAVY = (
    "scipy.stats", "scipy.signal", "matplotlib", "pyarrow", "jinja2",
    "pyapriltags", "multiprocessing.pool",
)  # fmt: skip


def loaded(*arguments: str) -> set[str]:
    """The modules in a fresh Python after `onebend` with these arguments; without any, after `import onebend`."""
    call = (
        "import sys, onebend\n"
        "if sys.argv[1:]:\n"
        "    from onebend.cli import app\n"
        "    try:\n        app(standalone_mode=False)\n    except SystemExit:\n        pass\n"
        "print('LOADED', *sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", call, *arguments], capture_output=True, text=True, check=True)
    return set(done.stdout.rpartition("LOADED")[2].split())


def of_onebend(modules: set[str]) -> set[str]:
    return {name for name in modules if name.split(".")[0] == "onebend"}


def test_import_loads_nothing() -> None:
    modules = loaded()
    assert of_onebend(modules) == {"onebend"}
    assert not modules & {"numpy", "scipy", "typer", "rich"}


@pytest.mark.parametrize("asked", ["--version", "--help"])
def test_version_and_help_load_no_command(asked: str) -> None:
    modules = loaded(asked)
    assert of_onebend(modules) == {
        "onebend",
        "onebend.wings",
        "onebend.progress",
        "onebend.cli",
        "onebend.crash",
        "onebend.errors",
    }
    assert not modules & {"numpy", "scipy", *HEAVY}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_of_the_options_as_they_are(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """`options.json` has them as the command has; `make docs` writes it anew."""
    stored, command = json.loads(OPTIONS.read_text(encoding="utf-8")), Command(name, COMMANDS[name])
    assert stored[name] == options_of(command.function())
    assert options_of(function_of(stored[name])) == stored[name]
    with_options = CliRunner().invoke(app, [name, "--help"])
    monkeypatch.setattr(Command, "described", lambda _: None)
    assert with_options.exit_code == 0
    assert with_options.stdout == CliRunner().invoke(app, [name, "--help"]).stdout


@pytest.mark.parametrize("name", sorted({"batch", "learn", "record"} & {*COMMANDS}))
def test_help_of_a_command_loads_none(name: str) -> None:
    modules = loaded(name, "--help")
    assert of_onebend(modules) == of_onebend(loaded("--help"))
    assert not modules & {"numpy", "scipy", *HEAVY}


def test_a_file_may_be_called_help() -> None:
    found = CliRunner().invoke(app, ["show", "--", "--help"])
    assert found.exit_code == 2
    assert "--help: no such file" in found.stderr


def test_light_commands_load_no_heavy_library(tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    fit = made_up.posterior()
    save_model(model, fit.beam, written_by="a test", uncertain=fit.stiffness)
    x, y = fit.beam.equilibrium((0.0, 0.05)).xy(1.0)
    for command in (
        ("show", str(model)),
        ("reach", str(model), "--goal", str(x), str(y)),
        ("new", str(tmp_path / "new")),
    ):
        assert not loaded(*command) & set(HEAVY), command


@pytest.mark.parametrize("name", COMMANDS)
def test_the_table_says_what_the_command_says(name: str) -> None:
    place = COMMANDS[name]
    assert Command(name, place).loaded().help == place.help


def test_every_command_is_in_the_table() -> None:
    """A public function of a command's module that takes `as_json` is a command."""
    places = {place.function for place in COMMANDS.values()}
    for module in {place.split(":")[0] for place in places}:
        for name, value in vars(import_module(module)).items():
            if isfunction(value) and value.__module__ == module and "as_json" in signature(value).parameters:
                assert f"{module}:{name}" in places


def test_help_lists_the_commands_by_group() -> None:
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).stdout
    at = [text.index(f"│ {name} ") for name in COMMANDS]
    assert at == sorted(at)
    heads = {text.index(f"─ {group} ─"): group for group in {one.group for one in COMMANDS.values()}}
    groups = [heads[max(head for head in heads if head < one)] for one in at]
    assert groups == [one.group for one in COMMANDS.values()]


def test_a_misspelt_command_is_answered_with_the_nearest() -> None:
    found = CliRunner().invoke(app, ["lern"])
    assert found.exit_code == 2
    assert "learn" in found.stderr
