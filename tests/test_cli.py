"""The command line: what is said, where, and with which exit code. The pipeline has its own test, end to end."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner, Result

from onebend import __version__, cli
from onebend.cli import learning as learning_commands, recordings as recording_commands
from onebend.control.reach import reach
from onebend.errors import LearningError
from onebend.learning.run import Run
from onebend.recording.bag_topics import BagContents
from onebend.recording.folder import folder_of, read_recording
from onebend.report.pictures import Pictures, draw
from onebend.results.model import load_model, save_model
from onebend.results.provenance import recording_files
from tests import made_up

EXAMPLE = Path(__file__).parents[1] / "examples" / "linear-beam" / "train"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(one) for one in arguments])


def refused(result: Result, *words: str) -> None:
    """One message on standard error, nothing on standard output, exit code 2, no traceback."""
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    for word in words:
        assert word in result.stderr.replace("\n", " "), result.stderr


@pytest.fixture
def pipeline(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """A pipeline that finds made-up things at once, and draws one picture; what it was asked is listed.

    All pictures of a report are drawn in tests/report/ and, by this command, in tests/attack/test_names_are_text.py.
    """
    asked: list[dict[str, Any]] = []

    def learn_from(*folders: Path, **options: Any) -> Run:
        asked.append({"folders": folders, **options})
        return made_up.findings(len(options["validate_on"]), fitted=options["fitting"] is not None)

    def compare(_: Any, folders: list[Path], **options: Any) -> list[Any]:
        asked.append({"folders": folders, **options})
        return [(made_up.comparison(one.name), made_up.observations(one.name)) for one in folders]

    def one_picture(*_: Any, **__: Any) -> Pictures:
        return draw({"stiffness": partial(Figure, figsize=(1, 1))})

    monkeypatch.setattr(learning_commands, "learn_from", learn_from)
    monkeypatch.setattr(learning_commands, "compare", compare)
    monkeypatch.setattr(learning_commands, "draw_all", one_picture)
    return asked


def fails(error: BaseException) -> Callable[..., Any]:
    def instead(*_: Any, **__: Any) -> Any:
        raise error

    return instead


def test_version_and_help() -> None:
    assert run("--version").stdout.strip() == f"onebend {__version__}"
    for command in ("learn", "validate", "new", "check", "show"):
        result = run(command, "--help")
        assert result.exit_code == 0
        assert command in result.stdout


def test_new_takes_one_kind_and_what_a_bag_tells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = tmp_path / "a bag.mcap"
    found = BagContents(bag, (), force="/wrench", image='/camera/"raw"')
    monkeypatch.setattr(recording_commands, "bag_contents", lambda *_: found)
    assert run("new", tmp_path / "mine", "--ros", bag).exit_code == 0
    text = (tmp_path / "mine" / "recording.toml").read_text(encoding="utf-8")
    written = [line for line in text.splitlines() if line.startswith(("file = ", "topic = "))]
    data = tomllib.loads("\n".join(line.replace(" = ", f"{i} = ", 1) for i, line in enumerate(written)))
    values = ["../a bag.mcap", '/camera/"raw"', "../a bag.mcap", "/wrench"]
    assert list(data.values()) == values
    assert any(line.startswith("axes =   ") for line in text.splitlines())  # which of the bag's axes, it cannot tell
    refused(run("new", tmp_path / "both", "--photos", "--mocap"), "--photos and --mocap", "one kind")
    assert not (tmp_path / "both").exists()


def test_learn_writes_results_and_shows_them(tmp_path: Path, pipeline: list[dict[str, Any]]) -> None:
    out = tmp_path / "out"
    result = run("learn", "REC", "-o", out, "--validate", "A", "--validate", "B")
    assert result.exit_code == 0, result.output
    for words in ("verdict", "k(s) = EI / L", "validation on other-2", "tag 3 was hidden", "95 % band", "next"):
        assert words in result.stdout, words
    assert result.stdout.splitlines()[-1] == f"report {out / 'report.html'}"
    written = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    expected = {
        "nuisances.csv",
        "model.json",
        "stiffness.csv",
        "selection.csv",
        "markers.csv",
        "validation.csv",
        "observations.parquet",
    }
    assert expected | {"summary.json", "report.html", "figures/stiffness.png"} <= written
    assert load_model(out) == made_up.posterior().beam
    assert set(json.loads((out / "summary.json").read_text(encoding="utf-8"))["files"]) == written
    assert pipeline[0]["validate_on"] == [Path("A"), Path("B")]


def test_learn_without_a_report_draws_nothing(
    tmp_path: Path, pipeline: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(learning_commands, "draw_all", fails(AssertionError()))
    result = run("learn", "REC", "-o", out, "--no-report")
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-1] == f"results {out}"
    written = {path.name for path in out.rglob("*")}
    assert {"model.json", "stiffness.csv", "summary.json"} <= written
    assert not written & {"report.html", "figures"}
    assert len(pipeline) == 1


def test_the_answer_comes_before_the_pictures(
    tmp_path: Path, pipeline: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(learning_commands, "draw_all", fails(KeyboardInterrupt()))
    result = run("learn", "REC", "-o", out)
    assert result.exit_code == 130
    assert f"report {out / 'report.html'}" in result.stdout
    assert "but for the pictures" in result.stderr
    assert (out / "report.html").is_file()
    assert run("learn", "REC", "-o", tmp_path / "other", "--json").stdout == ""
    assert len(pipeline) == 2


def test_learn_passes_its_options_on(tmp_path: Path, pipeline: list[dict[str, Any]]) -> None:
    text = "--method paper --family powers --width 0.2 --bic paper --n 5 --m 3 --threads 2 --epsilon-s 0.01 --quiet"
    assert run("learn", "REC", "-o", tmp_path / "out", *text.split()).exit_code == 0
    settings, observing = pipeline[0]["settings"], pipeline[0]["observing"]
    chosen = (settings.method, settings.family, settings.width, settings.bic, settings.n, settings.m)
    assert chosen == ("paper", "powers", 0.2, "paper", 5, 3)
    assert (observing.threads, observing.epsilon) == (2, 0.01)


def test_several_recordings_and_a_free_clamp_reach_the_fit(tmp_path: Path, pipeline: list[dict[str, Any]]) -> None:
    assert run("learn", "A", "B", "-o", tmp_path / "out", "--clamp-sd-deg", "1").exit_code == 0
    assert pipeline[0]["folders"] == (Path("A"), Path("B"))
    assert pipeline[0]["fitting"].clamp_sd == pytest.approx(np.deg2rad(1.0))
    assert pipeline[0]["settings"].method == "regression"


def test_the_regression_alone_shows_no_band(tmp_path: Path, pipeline: list[dict[str, Any]]) -> None:
    result = run("learn", "REC", "-o", tmp_path / "out", "--method", "regression")
    assert pipeline[0]["fitting"] is None
    assert "95 % band" not in result.stdout
    assert not (tmp_path / "out" / "nuisances.csv").exists()
    assert load_model(tmp_path / "out") == made_up.BEAM


def test_results_go_beside_where_one_stands_by_default(
    tmp_path: Path, pipeline: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("learn", "somewhere/push1/").exit_code == 0
    assert (tmp_path / "push1-results" / "model.json").is_file()
    assert len(pipeline) == 1


def test_json_is_one_object_and_nothing_else(tmp_path: Path, pipeline: list[dict[str, Any]]) -> None:
    result = run("learn", "REC", "-o", tmp_path / "out", "--validate", "A", "--json")
    data = json.loads(result.stdout, parse_constant=pytest.fail)
    chosen = data["regression"]["chosen"]
    assert (chosen["n"], chosen["m"]) == (4, 3)
    assert data["output"] == str(tmp_path / "out")
    result = run("validate", tmp_path / "out", "A", "--json")
    assert json.loads(result.stdout)["validation"][0]["recording"] == "A"
    result = run("show", tmp_path / "out", "--json")
    assert json.loads(result.stdout)["origin"]["recording"] == "made-up"
    assert len(pipeline) == 2


def test_earlier_results_are_refused_before_the_work(tmp_path: Path, pipeline: list[dict[str, Any]]) -> None:
    out = tmp_path / "out"
    assert run("learn", "REC", "-o", out).exit_code == 0
    (out / "notes.txt").write_text("mine")
    refused(run("learn", "REC", "-o", out), "already holds results", "--force")
    refused(run("learn", "REC", "-o", out, "--json"), "already holds results")
    assert len(pipeline) == 1
    assert run("learn", "REC", "-o", out, "--force").exit_code == 0
    assert (out / "notes.txt").read_text() == "mine"


def test_validate_shows_and_writes_tables(tmp_path: Path, pipeline: list[dict[str, Any]]) -> None:
    save_model(tmp_path / "model.json", made_up.BEAM, written_by="a test")
    result = run("validate", tmp_path, "A", "B")
    assert result.exit_code == 0, result.output
    assert [line.split()[0] for line in result.stdout.splitlines() if line.startswith((" A ", " B "))] == ["A", "B"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.json"]
    result = run("validate", tmp_path, "A", "-o", tmp_path / "checked")
    assert result.exit_code == 0, result.output
    written = {path.relative_to(tmp_path / "checked").as_posix() for path in (tmp_path / "checked").rglob("*.*")}
    figures = {f"figures/validation{end}.png" for end in ("", "-1-shapes", "-1-residuals")}
    assert written == {"validation.csv", "markers.csv", "summary.json"} | figures
    assert len(pipeline) == 2


def test_a_validation_does_not_replace_what_was_learned(tmp_path: Path, pipeline: list[dict[str, Any]]) -> None:
    assert run("learn", "REC", "-o", tmp_path / "out").exit_code == 0
    refused(run("validate", tmp_path / "out", "A", "-o", tmp_path / "out", "--force"), "not replaced")
    assert load_model(tmp_path / "out") == made_up.posterior().beam
    assert len(pipeline) == 1


def test_a_mistake_ends_in_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learning_commands, "learn_from", fails(LearningError("too few frames; film a longer push")))
    refused(run("learn", "REC", "-o", tmp_path / "out"), "onebend: too few frames; film a longer push")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learning_commands, "learn_from", fails(PermissionError(13, "Permission denied", "video.mp4")))
    refused(run("learn", "REC", "-o", tmp_path / "out"), "video.mp4: Permission denied")


def test_a_bug_is_not_dressed_up_as_a_mistake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learning_commands, "learn_from", fails(ZeroDivisionError()))
    result = run("learn", "REC", "-o", tmp_path / "out")
    assert result.exit_code == 1
    assert isinstance(result.exception, ZeroDivisionError)


def test_interrupted_before_anything_was_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learning_commands, "learn_from", fails(KeyboardInterrupt()))
    result = run("learn", "REC", "-o", tmp_path / "out")
    assert (result.exit_code, result.stderr) == (130, "onebend: Interrupted. Nothing was written.\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("learn", "nowhere", "-o", "out"),
        ("check", "nowhere"),
        ("validate", "nowhere", "nowhere"),
        ("show", "nowhere"),
        ("learn", EXAMPLE, "-o", EXAMPLE),
        ("learn", EXAMPLE, "-o", "out", "--validate", "nowhere"),
        ("learn", EXAMPLE, "-o", "out", "--n", "99"),
        ("learn",),
        ("learn", "REC", "--method", "magic"),
        ("learn", EXAMPLE, EXAMPLE, "-o", "out"),
        ("learn", EXAMPLE, EXAMPLE.parent / "fast", "-o", "out", "--method", "regression"),
        ("learn", EXAMPLE, "-o", "out", "--clamp-sd-deg", "-1"),
        ("nonsense",),
    ],
)
def test_requests_that_cannot_be_met(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[object, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(run(*arguments))
    assert list(tmp_path.iterdir()) == []


def test_a_broken_model_is_named(tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text("{", encoding="utf-8")
    refused(run("show", tmp_path), "model.json, line 1: not valid JSON")
    refused(run("validate", tmp_path / "model.json", EXAMPLE), "not valid JSON")


def test_new_then_check_leads_to_the_next_step(tmp_path: Path) -> None:
    result = run("new", tmp_path / "mine")
    assert result.exit_code == 0, result.output
    assert "onebend check" in result.stdout
    refused(run("new", tmp_path / "mine"), "exists already")
    refused(run("check", tmp_path / "mine"), "length_m is empty")


def test_new_names_the_film_and_the_log_that_are_there(tmp_path: Path) -> None:
    for name in ("Push 3.MOV", "wrench.csv", "notes.md", ".hidden.mp4"):
        (tmp_path / name).write_text("x")
    result = run("new", tmp_path)
    assert result.exit_code == 0
    assert "put the video" not in result.stdout
    written = (tmp_path / "recording.toml").read_text()
    assert 'file = "Push 3.MOV"' in written
    assert 'file = "wrench.csv"' in written
    (tmp_path / "recording.toml").unlink()
    (tmp_path / "another.csv").write_text("x")
    result = run("new", tmp_path)
    assert result.exit_code == 0
    assert "put the video and the force log beside it" in " ".join(result.stdout.split())
    assert 'file = "force.csv"' in (tmp_path / "recording.toml").read_text()


def test_check_says_what_was_understood(tmp_path: Path) -> None:
    result = run("check", EXAMPLE, "-o", tmp_path / "check.png")
    assert result.exit_code == 0, result.output
    for words in ("150 mm long", "1280 x 720", "536 frames", "1000 Hz", "tag 3 at s = 1", "tags seen 0, 1, 2, 3"):
        assert words in " ".join(result.stdout.split()), words
    assert (tmp_path / "check.png").stat().st_size > 50_000
    (tmp_path / "mine.png").write_bytes(b"a picture of my own")
    refused(run("check", EXAMPLE, "-o", tmp_path / "mine.png"), "exists already")


def test_a_recording_may_be_named_by_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = EXAMPLE.parents[1] / "hung-weights"
    by_folder = run("check", weights, "-o", tmp_path / "a.png", "--json")
    by_file = run("check", weights / "recording.toml", "-o", tmp_path / "a.png", "--json")
    assert by_file.exit_code == 0
    assert by_file.stdout == by_folder.stdout
    said = json.loads(by_folder.stdout)
    assert (said["recording"], said["picture"]) == ("hung weights", str(tmp_path / "a.png"))
    assert recording_files([EXAMPLE / "recording.toml"]) == recording_files([EXAMPLE])
    assert folder_of("somewhere/push2/recording.toml") == Path("somewhere/push2")
    monkeypatch.chdir(EXAMPLE)
    assert read_recording("recording.toml").video == read_recording(".").video
    refused(run("check", tmp_path / "nowhere" / "recording.toml"), "nowhere is not a folder")
    refused(run("check", tmp_path / "recording.toml"), "holds no recording.toml")
    refused(run("learn", EXAMPLE, EXAMPLE / "recording.toml", "-o", tmp_path / "out"), "is given twice")


def test_show_draws_the_model(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", made_up.BEAM, written_by="a test")
    result = run("show", tmp_path)
    assert result.exit_code == 0
    assert "━" in result.stdout
    assert "length 150 mm" in result.stdout
    fit = made_up.posterior()
    save_model(tmp_path / "model.json", fit.beam, written_by="a test", uncertain=fit.stiffness)
    assert "95 % band" in run("show", tmp_path).stdout
    shown = json.loads(run("show", tmp_path, "--json").stdout)
    np.testing.assert_allclose(shown["stiffness"]["k_hi_N_m"], fit.band(np.linspace(0, 1, 11)).high)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("reach", "x", "--goal", "0.12"), "--goal needs 2 numbers: X Y"),
        (("reach", "x", "--goal", "0.12", "-o", "y"), "--goal needs 2 numbers: X Y"),
        (("reach", "x", "--goal", "1", "2", "--push-at", "tip"), "--push-at needs a number: S"),
        (("export", "x", "--to", "mujco", "-o", "y"), "Did you mean mujoco?"),
        (("export", "x", "--to", "mujco", "-o", "y"), "'--to': 'mujco' is not one of"),
    ],
)
def test_a_wrong_option_says_what_it_needs(arguments: tuple[str, ...], words: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.replace("│", " ").split())


def test_help_and_the_version_have_their_usual_names() -> None:
    assert run("help", "reach").stdout == run("reach", "--help").stdout
    assert run("help").stdout == run("--help").stdout
    assert run("-V").stdout == run("--version").stdout == f"onebend {__version__}\n"


def test_results_show_themselves_in_a_line() -> None:
    uncertain = made_up.posterior().stiffness
    assert re.fullmatch(r"Beam\(length=0.15 m, k=[0-9.]+ to [0-9.]+ N m\)", repr(made_up.BEAM))
    assert repr(uncertain).startswith("UncertainStiffness(k=")
    assert "(95 %, median)" in repr(uncertain)
    found = reach(made_up.BEAM, made_up.BEAM.equilibrium((0.0, 0.1)).xy(1.0))
    assert re.fullmatch(r"Reach\(goal=\([0-9.]+, [0-9.]+\) m, force=\(-?[0-9.e-]+, 0\.1\) N\)", repr(found))
