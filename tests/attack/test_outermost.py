"""Whatever happens, one line and an exit code; the rest in a file. Output that cannot be written ends cleanly."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from onebend.cli import app
from onebend.crash import guarded
from onebend.results.model import save_model
from tests import made_up
from tests.attack.scripts import environment, onebend


def raising(error: BaseException) -> Callable[[], None]:
    def work() -> None:
        raise error

    return work


class UnspeakableError(Exception):
    """An error whose own words fail."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


def deep(n: int = 0) -> int:
    return deep(n + 1) + 1


@pytest.mark.parametrize(
    ("work", "words"),
    [
        (raising(MemoryError()), "not enough memory"),
        (raising(ZeroDivisionError("division by zero")), r"\(ZeroDivisionError: division by zero\)"),
        (deep, r"\(RecursionError: "),
        (raising(UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid")), r"\(UnicodeDecodeError: "),
        (raising(UnicodeEncodeError("cp1252", "\u2501", 0, 1, "none")), r"\(UnicodeEncodeError: "),
        (raising(ExceptionGroup("some", [ValueError("a")])), r"\(ExceptionGroup: some"),
        (raising(ValueError("\x1b[31m red\n two " + 5000 * "x")), r"\(ValueError: \\x1b\[31m red\\n two x"),
        (raising(UnspeakableError()), r"\(UnspeakableError\)"),
        (raising(AssertionError()), r"\(AssertionError\)"),
    ],
)
def test_the_unforeseen_ends_in_one_line_and_a_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    work: Callable[[], object],
    words: str,
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(SystemExit) as ended:
        guarded(work, "1.2.3")
    assert ended.value.code == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert len(said.err) < 800
    assert re.search(words, said.err), said.err
    [file] = tmp_path.iterdir()
    assert str(file) in said.err
    text = file.read_text(encoding="utf-8")
    assert "onebend 1.2.3" in text
    assert "Traceback" in text
    assert file.stat().st_mode & 0o077 == 0  # for nobody else


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (SystemExit(0), 0, ""),
        (SystemExit(130), 130, ""),
        (SystemExit(None), None, ""),
        (KeyboardInterrupt(), 130, "onebend: Interrupted.\n"),
        (BrokenPipeError(32, "Broken pipe"), 2, ""),
        (PermissionError(13, "Permission denied", "x.csv"), 2, "onebend: x.csv: Permission denied.\n"),
    ],
)
def test_what_is_foreseen_needs_no_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int | None,
    said: str,
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(SystemExit) as ended:
        guarded(raising(error), "1.2.3")
    assert ended.value.code == code
    assert capsys.readouterr().err == said
    assert list(tmp_path.iterdir()) == []


def test_without_a_place_for_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(SystemExit):
        guarded(raising(ValueError("x")), "1.2.3")
    assert "Nothing more could be written down" in capsys.readouterr().err


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    fit = made_up.posterior()
    save_model(folder / "model.json", fit.beam, written_by="a test", uncertain=fit.stiffness)
    return folder


SLOW = pytest.mark.slow


@pytest.mark.slow
@pytest.mark.parametrize(
    "encoding", ["cp1252", *(pytest.param(name, marks=SLOW) for name in ("ascii", "utf-16", "latin-1"))]
)
def test_an_output_without_our_characters_still_gets_the_rest(model: Path, encoding: str) -> None:
    done = onebend("show", model, environment={"PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"})
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr
    assert "length 150 mm" in done.stdout.decode(encoding)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize(
    "arguments",
    [
        "show",
        *(pytest.param(one, marks=SLOW) for one in ("show --json", "export --to=numpy --force", "--help")),
    ],
)
def test_an_output_that_is_full_ends_cleanly(model: Path, tmp_path: Path, arguments: str) -> None:
    command, *options = arguments.split()
    words = [command, *([] if command == "--help" else [model]), *options]
    with Path("/dev/full").open("wb") as full:
        done = onebend(*words, capture_output=False, stdout=full, stderr=subprocess.PIPE, cwd=tmp_path)
        both = onebend(*words, capture_output=False, stdout=full, stderr=full, cwd=tmp_path)
    assert done.returncode == both.returncode == 2
    assert done.stderr.count(b"\n") == 1
    assert b"No space left on device" in done.stderr
    assert b"Traceback" not in done.stderr


def test_a_reader_that_goes_ends_it_quietly(model: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "onebend", "show", str(model)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment(),
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 2


@pytest.mark.slow
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", "<&-"])
def test_closed_streams(model: Path, closed: str) -> None:
    command = f'"{sys.executable}" -m onebend show "{model}" {closed}'
    done = subprocess.run(["sh", "-c", command], capture_output=True, env=environment(), check=False)
    assert b"Traceback" not in done.stderr + done.stdout
    assert done.returncode in (0, 2)


def test_names_of_bytes_that_are_no_text(tmp_path: Path) -> None:
    name = os.fsdecode(bytes(tmp_path) + b"/\xff\x1b[31m")
    result = CliRunner().invoke(app, ["show", name])
    assert result.exit_code == 2
    assert "\x1b" not in result.stderr
    assert "\\udcff\\x1b[31m: no such file" in result.stderr


def test_an_interrupt_while_the_program_is_loaded() -> None:
    """The modules are some tenths of a second's work: who presses Ctrl-C then has seen nothing yet."""
    code = """
import sys
class Pressed:
    def find_spec(self, name, path=None, target=None):
        if name == "onebend.cli":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Pressed())
from onebend.__main__ import main
main()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment())
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")


FAULTY = "import numpy as np, onebend.cli as cli; cli.app = lambda: {work}; cli.main()"
OVERFLOWS = "np.array([1e200]) ** 2"
BESIDE = (
    "__import__('subprocess').call([__import__('sys').executable, '-c', 'import numpy as np; np.array([1e200]) ** 2'])"
)


@pytest.mark.parametrize("work", [OVERFLOWS, BESIDE], ids=["here", "beside"])
@pytest.mark.parametrize("asked", [True, False], ids=["asked for", "not asked for"])
def test_warnings_of_numpy_are_shown_who_asks_for_them(work: str, asked: bool) -> None:
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONWARNINGS"}
    if asked:
        variables["PYTHONWARNINGS"] = "default"
    done = subprocess.run(
        [sys.executable, "-c", FAULTY.format(work=work)], env=variables, capture_output=True, text=True, check=False
    )
    assert ("RuntimeWarning" in done.stderr) is asked
