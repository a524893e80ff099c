"""The bundled recording, from its video to the results on disk: interrupted once, then gone on with."""

from __future__ import annotations

import json
import re
import runpy
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import onebend
from onebend import cli, fit, load_model, load_observations, load_uncertain
from onebend.cli import learning as learning_commands
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Posterior
from onebend.pipeline import Run, learn
from onebend.recording.entries import VideoEntry
from onebend.recording.tags import detect_tags
from onebend.records import Detections, Observations, tags_among
from onebend.results import detection_cache

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "linear-beam"
SCRIPT = ROOT / "examples" / "learn_linear_beam.py"
QUICK = FitSettings(functions=16, most_frames=80, first_frames=40)
SAYS = [
    "k at base, middle and tip [N m]",
    "95 % band, from",
    "RMS of the three markers on the fast push [mm]",
    "the tip would go to [mm]",
]


class Runs(NamedTuple):
    """The run that was interrupted while it drew the figures, and the one that went on."""

    interrupted: Result
    left_behind: list[str]
    finished: Result
    out: Path
    kept: Path  # what was found in the films


def learn_with(quick: FitSettings, *recordings: Path, **options: Any) -> Run:
    return learn(*recordings, **(options | {"fitting": quick}))


def interrupted(*_: object, **__: object) -> NoReturn:
    raise KeyboardInterrupt


def unless_train(video: VideoEntry, *given: Any, **more: Any) -> Detections:
    """`detect_tags`, but for the film that was searched already."""
    return interrupted() if video.file == EXAMPLE / "train" / "video.mp4" else detect_tags(video, *given, **more)


def changed(folder: Path, name: str, old: str, new: str) -> Path:
    """A recording of the example with another description."""
    text = (EXAMPLE / name / "recording.toml").read_text(encoding="utf-8")
    assert old in text
    (folder / "recording.toml").write_text(text.replace(old, new), encoding="utf-8")
    for file in ("video.mp4", "force.csv"):
        (folder / file).symlink_to(EXAMPLE / name / file)
    return folder


@pytest.fixture(scope="session")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    """Tags are found once: the second run must take them from what the first one kept."""
    out, kept = tmp_path_factory.mktemp("runs") / "linear", tmp_path_factory.mktemp("kept")
    bare = changed(tmp_path_factory.mktemp("bare"), "train", "[force]", "[outline]\nuse = false\n\n[force]")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ONEBEND_CACHE", str(kept))
        patch.setattr(learning_commands, "draw_all", interrupted)
        quick = partial(learn_with, QUICK)  # of this run only the files are looked at
        patch.setattr(learning_commands, "learn_from", quick)
        first = CliRunner().invoke(cli.app, ["learn", str(bare), "-o", str(out)])
        left = sorted(path.name for path in out.parent.rglob("*"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ONEBEND_CACHE", str(kept))
        patch.setattr(detection_cache, "detect_tags", unless_train)
        command = ["learn", str(EXAMPLE / "train"), "-o", str(out), "--validate", str(EXAMPLE / "fast")]
        second = CliRunner().invoke(cli.app, [*command, "--json", "--force"])
    return Runs(first, left, second, out, kept)


def test_an_interrupted_run_says_what_it_kept(runs: Runs) -> None:
    assert runs.interrupted.exit_code == 130, runs.interrupted.output
    assert f"The results are in {runs.out}, but for the pictures." in runs.interrupted.stderr
    assert {"model.json", "stiffness.csv", "report.html", "summary.json"} <= set(runs.left_behind)
    assert not any(name.endswith(".png") for name in runs.left_behind)


def test_the_next_run_goes_on_and_leaves_whole_results(runs: Runs) -> None:
    assert runs.finished.exit_code == 0, runs.finished.output
    assert [path.name for path in runs.out.parent.iterdir()] == ["linear"]
    summary = json.loads((runs.out / "summary.json").read_text(encoding="utf-8"))
    assert set(summary["files"]) == {p.relative_to(runs.out).as_posix() for p in runs.out.rglob("*") if p.is_file()}
    assert "figures/fit.png" in summary["files"]


def test_json_on_standard_output_agrees_with_the_files(runs: Runs) -> None:
    printed = json.loads(runs.finished.stdout)
    summary = json.loads((runs.out / "summary.json").read_text(encoding="utf-8"))
    for key in ("fit", "regression", "stiffness", "training", "validation", "observed"):
        assert printed[key] == summary[key]
    table = np.genfromtxt(runs.out / "stiffness.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    beam, band = load_model(runs.out), load_uncertain(runs.out).band(table["s"])
    np.testing.assert_allclose(table["k_lo_N_m"], band.low, rtol=1e-8)
    assert ((table["identified"] == "yes") == band.identified).all()
    np.testing.assert_allclose(table["k_N_m"], beam.stiffness(table["s"]), rtol=1e-8)
    assert table["k_N_m"].min() > 0.0


def test_the_learned_beam_follows_both_pushes(runs: Runs) -> None:
    """A sixth of the 0.12 m that the tip moves would be no fit; the log's drift alone moves it by some millimetres."""
    summary = json.loads((runs.out / "summary.json").read_text(encoding="utf-8"))
    for one in (*summary["training"], *summary["validation"]):
        assert max(one["rms_m"]) < 0.02
        assert one["all_stable"]
    seen = load_observations(runs.out)
    assert np.isfinite(seen.xy[:, tags_among(seen)]).all(axis=-1).mean() > 0.99
    assert summary["observed"][0]["clock"]["found"]
    assert summary["fit"]["converged"]
    assert max(summary["fit"]["fitted_rms_m"][0]) < 1.2e-4  # the fit itself, without the log's slow error


@pytest.mark.slow
def test_validate_gives_the_numbers_of_learn_again(runs: Runs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ONEBEND_CACHE", str(runs.kept))
    result = CliRunner().invoke(cli.app, ["validate", str(runs.out), str(EXAMPLE / "fast"), "--json", "--quiet"])
    assert result.exit_code == 0, result.output
    again, before = json.loads(result.stdout)["validation"], json.loads(runs.finished.stdout)["validation"]
    np.testing.assert_allclose(again[0]["rms_m"], before[0]["rms_m"], rtol=1e-6)
    assert list(tmp_path.iterdir()) == []


def test_validating_on_a_beam_of_another_length_is_refused(runs: Runs, tmp_path: Path) -> None:
    other = changed(tmp_path, "fast", "length_m = 0.15", "length_m = 0.3")
    result = CliRunner().invoke(cli.app, ["validate", str(runs.out), str(other)])
    assert result.exit_code == 2
    assert "300 mm long, the learned one 150 mm" in result.stderr.replace("\n", " ")


@pytest.fixture(scope="module")
def fitted(runs: Runs) -> Posterior:
    """What was observed above, fitted with fewer functions."""
    return fit([load_observations(runs.out)], settings=QUICK)


@pytest.fixture
def asked(runs: Runs, fitted: Posterior, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """What an example observes, and fits: each time what was observed and fitted above."""
    seen, asked = load_observations(runs.out), list[Path]()

    def fit_again(given: Sequence[Observations]) -> Posterior:
        assert given[0] is seen
        return fitted

    def observe(folder: Path | str) -> Observations:
        asked.append(ROOT / folder)
        return seen

    monkeypatch.setattr(onebend, "observe", observe)
    monkeypatch.setattr(onebend, "fit", fit_again)
    return asked


@pytest.mark.slow
def test_the_example_says_what_it_finds(asked: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(SCRIPT))
    assert asked == [EXAMPLE / "train", EXAMPLE / "fast"]
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()] == SAYS


def test_the_example_of_the_readme_says_what_it_finds(asked: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    [example] = re.findall(r"(?ms)^```python\n(.*?)^```$", (ROOT / "README.md").read_text(encoding="utf-8"))
    exec(example, {})
    assert asked == [EXAMPLE / "train", EXAMPLE / "fast"]
    said = [line.split(":")[0] for line in capsys.readouterr().out.splitlines()]
    assert said == [SAYS[0], "error of the tags on another push, RMS [mm]", "0.2 N put the tip at [m]"]


@pytest.mark.slow
def test_the_example_runs() -> None:
    done = subprocess.run([sys.executable, "-W", "error", str(SCRIPT)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == SAYS
