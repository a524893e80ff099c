"""The example at the end of each command's help, run as it is printed; and what a shell completes."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from onebend.cli import all_commands, app
from tests.recording.bagged import log, write_mcap
from tests.recording.board_film import CHESS
from tests.recording.calibration.test_intrinsics import shown

COMMANDS = all_commands()

ROOT = Path(__file__).parents[2]
# Those that take seconds need the result of `make demo` itself, or make films; the others do with a designed beam.
DEAR = (
    "learn", "validate", "plan", "damp", "loop", "check", "sense",
    "film", "calibrate", "rehearse", "batch",
    "population", "record", "drive",
)  # fmt: skip
ENDLESS = ("studio",)  # it serves until it is stopped; tests/studio/ starts it


def example_of(name: str) -> list[str]:
    """The commands at the end of the help, as a screen of 80 columns shows them."""
    text = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "80"}).stdout
    _, _, end = text.rpartition("Example:")
    return [line.strip() for line in end.splitlines() if line.strip()]


def run(line: str) -> Result:
    onebend, *words = shlex.split(line)
    assert onebend == "onebend"
    return CliRunner().invoke(app, words)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_ends_with_an_example_that_can_be_copied(name: str) -> None:
    place = COMMANDS[name]
    assert example_of(name) == [*filter(None, [place.first]), f"onebend {name} {place.example}".strip()]


def workplace(folder: Path) -> None:
    """A folder with the examples, as a copy of the repository is, and a bag."""
    folder.mkdir(exist_ok=True)
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "out").mkdir()
    (folder / "my-beam").mkdir()
    write_mcap(folder / "my-beam" / "push.mcap", log())


@pytest.fixture(scope="module")
def stand_in(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The beam of `make demo` as designed in place of as learned."""
    model = tmp_path_factory.mktemp("designed") / "model.json"
    assert run(f"onebend design linear --model {model}").exit_code == 0
    return model


@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in (*DEAR, *ENDLESS)])
def test_the_example_runs(name: str, stand_in: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workplace(tmp_path)
    (tmp_path / "out" / "linear-beam").mkdir()
    shutil.copy(stand_in, tmp_path / "out" / "linear-beam")
    monkeypatch.chdir(tmp_path)
    for line in example_of(name):
        done = run(line)
        assert done.exit_code == 0, (line, done.output, done.stderr)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of `make demo` itself."""
    folder = tmp_path_factory.mktemp("demo") / "copy"
    workplace(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        [line] = example_of("learn")
        done = run(line)
    assert done.exit_code == 0, done.output
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in ("learn", *ENDLESS)])
def test_the_example_runs_on_the_demo(name: str, demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workplace(tmp_path)
    shutil.copytree(demo / "out" / "linear-beam", tmp_path / "out" / "linear-beam")
    monkeypatch.chdir(tmp_path)
    if name == "calibrate":
        shutil.copy(shown(tmp_path / "filmed.mp4", CHESS, 24), "board.mp4")
    for line in example_of(name):
        done = run(line.replace("9x6", f"{CHESS.columns}x{CHESS.rows}"))
        assert done.exit_code == 0, (line, done.output, done.stderr)


COMPLETE = "_ONEBEND_COMPLETE"
CALLED = "import sys; sys.argv[0] = 'onebend'; from onebend.cli import main; main()"


@pytest.fixture
def no_shell(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shell is the one that is asked for, not the one that runs the tests."""
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")


def completed(shell: str, **asked: str) -> str:
    environment = {**os.environ, COMPLETE: f"complete_{shell}", **asked}
    done = subprocess.run([sys.executable, "-c", CALLED], env=environment, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    return done.stdout


@pytest.mark.slow
def test_a_shell_completes_commands_and_options() -> None:
    assert completed("bash", COMP_WORDS="onebend re", COMP_CWORD="1").split() == [
        name for name in COMMANDS if name.startswith("re")
    ]
    assert completed("bash", COMP_WORDS="onebend new --mo", COMP_CWORD="2").split() == ["--mocap"]


@pytest.mark.slow
def test_other_shells_do_too_and_choices_are_completed() -> None:
    assert '"--mocap"' in completed("zsh", _TYPER_COMPLETE_ARGS="onebend new --moc")
    asked = {"_TYPER_COMPLETE_FISH_ACTION": "get-args", "_TYPER_COMPLETE_ARGS": "onebend le"}
    assert completed("fish", **asked).startswith("learn\t")
    choices = completed("bash", COMP_WORDS="onebend learn --method ", COMP_CWORD="3")
    assert choices.split() == ["fit", "regression", "paper"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
@pytest.mark.usefixtures("no_shell")
def test_the_script_of_each_shell_calls_onebend(shell: str) -> None:
    done = CliRunner().invoke(app, ["--show-completion", shell], prog_name="onebend")
    assert done.exit_code == 0
    assert f"{COMPLETE}=complete_{shell}" in done.stdout


@pytest.mark.usefixtures("no_shell")
def test_bash_itself_completes_with_the_script(tmp_path: Path) -> None:
    if (bash := shutil.which("bash")) is None:
        pytest.skip("there is no bash here")
    script = CliRunner().invoke(app, ["--show-completion", "bash"], prog_name="onebend").stdout
    command = tmp_path / "onebend"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{CALLED}" "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    ask = 'COMP_WORDS=(onebend reh); COMP_CWORD=1; _onebend_completion onebend; echo "${COMPREPLY[@]}"'
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        [bash, "-c", f"{script}\n{ask}"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["rehearse"], done.stderr
