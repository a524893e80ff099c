"""What a person named is text for pictures, tables, terminals and JSON, and acts on none of them."""

from __future__ import annotations

import csv
import io
import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table
from ruamel.yaml import YAML
from typer.testing import CliRunner

from onebend import cli
from onebend.cli import learning as learning_commands
from onebend.cli.common import Bars, text_alone
from onebend.cli.recordings import show_overview
from onebend.cli.screens import show_run
from onebend.errors import RecordingError
from onebend.report.figures import draw_all
from onebend.report.overview import Overview, overview
from onebend.report.pictures import Pictures, draw
from onebend.report.style import png_of
from onebend.results.model import origin_of, save_model
from onebend.results.tables import write_csv
from onebend.text_files import csv_cell, figure_text, one_line, printable, to_json
from tests import made_up

EXAMPLE = Path(__file__).parents[2] / "examples" / "linear-beam" / "train"
NAMES = [
    r"$\frac", "$", "$$", r"\$x$", r"$\unknown{1}$", "a$b$c", r"\frac{1}{2}", "{", "%s", "{0}",
    "=HYPERLINK(\"http://x\",\"y\")", "+1+1", "-2+3", "@SUM(A1)", "\t=1+1", "\r=1+1", "|calc", "%0A=1",
    "\x1b[2J\x1b[31mred", "\x1b]0;title\x07", "\x9b31m", "a\nb", "\u202egnp.exe", "\u200b", "\x00", "\x7f", "\b\b\b",
    "[bold]x[/]", "[/]", "[link=http://x]y[/link]", "<b>x</b>", "梁の試験", "😀" * 40, "é", "x" * 100_000, "", " ",
]  # fmt: skip
ACTING = set(map(chr, [*range(0x20), 0x7F, *range(0x80, 0xA0), *range(0x202A, 0x202F), 0x200B])) - {"\n"}


def named(found: Any, name: str) -> Any:
    """The findings with the recordings called so, whatever says their name."""
    comparisons = tuple(replace(one, name=name) for one in found.trainings)
    recordings = tuple(replace(one, source=replace(one.source, name=name)) for one in found.recordings)
    validations = tuple(replace(one, name=name) for one in found.validations)
    return replace(found, trainings=comparisons, recordings=recordings, validations=validations)


@pytest.fixture
def learned_from(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Learning comes to made-up findings, at once, on a recording of a name."""

    def called(name: str) -> None:
        found = named(made_up.findings(1), name)
        monkeypatch.setattr(learning_commands, "learn_from", lambda *_, **__: found)

    return called


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_drawn_as_it_is(name: str) -> None:
    figure = Figure(figsize=(2, 1))
    text = figure.suptitle(figure_text(name))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        assert png_of(figure).startswith(b"\x89PNG")
    assert not text.get_text().count("$") - text.get_text().count(r"\$")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_no_picture_of_a_report_fails_by_a_name(name: str) -> None:
    pictures = draw_all(named(made_up.findings(1), name))
    assert pictures.failed == {}
    assert {"fit", "shapes", "residuals", "validation"} & set(pictures.drawn)


@pytest.mark.slow
def test_a_name_does_not_cost_the_run(tmp_path: Path, learned_from: Callable[[str], None]) -> None:
    learned_from("$\\frac\x1b[31m=1")
    result = CliRunner().invoke(cli.app, ["learn", "REC", "-o", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "\x1b" not in result.stdout + result.stderr
    assert "$\\frac\\x1b[31m=1" in result.stdout
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert summary["recordings"] == ["$\\frac\x1b[31m=1"]  # for programs: as it is
    assert summary["pictures_failed"] == {}
    assert (tmp_path / "out" / "figures" / "shapes.png").exists()


def test_a_picture_that_fails_costs_that_picture(
    tmp_path: Path, learned_from: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails() -> None:
        raise MemoryError("too \x1b[31m large")

    def two(*_: object, **__: object) -> Pictures:
        return draw({"shapes": fails, "residuals": partial(Figure, figsize=(1, 1))})

    learned_from("a")
    monkeypatch.setattr(learning_commands, "draw_all", two)
    result = CliRunner().invoke(cli.app, ["learn", "REC", "-o", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert "the picture 'shapes' could not be drawn (MemoryError: too \\x1b[31m large)" in result.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert set(summary["pictures_failed"]) == {"shapes"}
    assert "figures/residuals.png" in summary["files"]
    assert "figures/shapes.png" not in summary["files"]


@pytest.mark.parametrize("ends", [KeyboardInterrupt(), MemoryError(), SystemExit(1), OSError(28, "No space left")])
def test_the_fit_is_in_place_before_a_picture_is_drawn(
    tmp_path: Path, learned_from: Callable[[str], None], monkeypatch: pytest.MonkeyPatch, ends: BaseException
) -> None:
    def dies(*_: object, **__: object) -> None:
        raise ends

    learned_from("a")
    monkeypatch.setattr(learning_commands, "draw_all", dies)
    assert CliRunner().invoke(cli.app, ["learn", "REC", "-o", str(tmp_path / "out")]).exit_code != 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"model.json", "stiffness.csv", "observations.parquet", "report.html", "summary.json"} <= names


@pytest.mark.parametrize("name", NAMES)
def test_a_table_has_no_formula_and_comes_back_row_by_row(tmp_path: Path, name: str) -> None:
    write_csv(tmp_path / "t.csv", ["name", "x"], [[name, "-0.5"], ["plain", "nan"]])
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as stream:
        csv.field_size_limit(200_000)
        rows = list(csv.reader(stream))
    assert [row[1] for row in rows] == ["x", "-0.5", "nan"]
    assert len((tmp_path / "t.csv").read_text(encoding="utf-8").splitlines()) == 3
    cell = rows[1][0]
    assert not cell.lstrip(' "').startswith(("=", "+", "-", "@", "\t", "\r", "|", "%"))
    assert not ACTING & set(cell)


@given(st.text())
def test_escaped_text_never_acts(text: str) -> None:
    assert not ACTING & set(printable(text))
    assert "\n" not in one_line(text)
    printable(text).encode()  # every encoding that has all characters has it
    assert printable(printable(text)) == printable(text)


@given(st.floats(allow_nan=True) | st.integers())
def test_numbers_are_left_as_they_are(value: float) -> None:
    assert csv_cell(f"{value:.9g}") == f"{value:.9g}"
    assert csv_cell(value) is value


@pytest.mark.parametrize("name", NAMES)
def test_nothing_named_reaches_the_terminal_as_a_sequence(name: str) -> None:
    stream = io.StringIO()
    console = text_alone(Console(file=stream, width=80, force_terminal=False, color_system=None, highlight=False))
    table = Table(title=one_line(name)[:80].replace("[", "\\["))
    table.add_row(name.replace("[", "\\["))
    console.print(table)
    console.print(name, markup=False)
    with Bars(console) as bars:
        bars.start(name, 1)
        bars.done()
    assert not ACTING & set(stream.getvalue())


@pytest.fixture(scope="module")
def seen(sound: Path) -> Overview:
    return overview(sound)


@pytest.mark.parametrize("name", ["[/]", "[bold]x", "\\[/]", "\x1b[2J[red]", "x" * 100_000])
def test_the_screens_take_any_name(seen: Overview, name: str) -> None:
    stream = io.StringIO()
    console = text_alone(Console(file=stream, width=100, color_system=None, highlight=False))
    show_run(console, named(made_up.findings(1), name), Path("out"))
    show_overview(console, replace(seen, name=name))
    text = stream.getvalue()
    assert not ACTING & set(text)
    assert one_line(name)[:5] in text


def test_colours_of_our_own_stay() -> None:
    stream = io.StringIO()
    console = text_alone(Console(file=stream, width=80, force_terminal=True, color_system="standard", highlight=False))
    console.print("[red]x[/]\x1b[2J")
    assert stream.getvalue() == "\x1b[31mx\x1b[0m\\x1b[2J\n"


@pytest.mark.parametrize("name", NAMES)
def test_errors_and_doubts_are_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def fails(*_: object, **__: object) -> None:
        raise RecordingError(f"key '{name}' is not known")

    monkeypatch.setattr(learning_commands, "learn_from", fails)
    result = CliRunner().invoke(cli.app, ["learn", "REC", "-o", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert not ACTING & set(result.stderr)
    fit = made_up.posterior()
    doubted = replace(fit.stiffness, doubts=(name,))
    save_model(tmp_path / "model.json", fit.beam, written_by="a test", uncertain=doubted)
    for arguments in (
        ["show", str(tmp_path)],
        ["export", str(tmp_path), "--to", "numpy", "-o", str(tmp_path / "n.npz")],
    ):
        result = CliRunner().invoke(cli.app, arguments)
        assert result.exit_code == 0, result.output
        assert not ACTING & set(result.stdout + result.stderr)


@given(st.text(alphabet=st.characters()))
def test_json_is_valid_and_acts_on_nothing(text: str) -> None:
    for ascii_only in (False, True):
        written = to_json({"name": text, text: 1}, ascii_only=ascii_only)
        assert json.loads(written)["name"] == text
        assert not ACTING & set(written)
        written.encode("ascii" if ascii_only else "utf-8")


def test_json_in_an_encoding_that_lacks_the_name(tmp_path: Path) -> None:
    origin = origin_of(None, made_up.posterior(), [made_up.comparison("梁 é \udcff")])
    save_model(tmp_path / "model.json", made_up.BEAM, written_by="a test", origin=origin)
    for charset in ("cp1252", "utf-8"):
        result = CliRunner(charset=charset).invoke(cli.app, ["show", str(tmp_path), "--json"])
        assert result.exit_code == 0, result.output
        assert json.loads(result.stdout)["origin"]["recording"] == "梁 é \udcff"


def test_a_name_that_no_encoding_has_is_still_written() -> None:
    """A file's name of bytes that are no UTF-8 comes as halves of surrogate pairs."""
    assert json.loads(to_json("\udcff")) == "\udcff"
    assert to_json("\udcff").encode() == b'"\\udcff"'
    assert printable("\udcff") == "\\udcff"


@pytest.mark.parametrize("name", [*NAMES[:35], "true", "NULL", "1e3", "beam_base", "- a", "a: b", "a #b", "no", "[x"])
def test_a_frame_is_one_string_in_yaml(name: str) -> None:
    message = {"header": {"stamp": {"sec": 1}, "frame_id": name}, "names": [name, "x"]}
    assert YAML(typ="safe").load(to_json(message)) == message


def test_a_frame_that_cannot_be_printed_is_refused(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", made_up.BEAM, written_by="a test")
    for name in ("", "a\nb", "\x1b[2J", "\udcff"):
        result = CliRunner().invoke(cli.app, ["path", str(tmp_path), "--goals", "none.csv", "--frame", name])
        assert result.exit_code == 2
        assert "is no name of a frame" in result.stderr
