"""`onebend plan`: from a model.json with a band to proposals, and a clear word where there is no band."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from onebend import cli
from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import ResultsError
from onebend.learning.instruments import instruments_of
from onebend.learning.posterior import Posterior, fit
from onebend.results.model import read_model, save_model
from tests.learning.bench import IDEAL, SOFT, forces, observed


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(one) for one in arguments], env={"COLUMNS": "200"})


@pytest.fixture(scope="module")
def known() -> Posterior:
    made = observed(SOFT, forces(30, most=0.5), at_s=0.6, noise=(2e-5, 1e-3))
    return fit([made], 0.02, settings=replace(IDEAL, functions=8))


@pytest.fixture
def model(known: Posterior, tmp_path: Path) -> Path:
    file = tmp_path / "model.json"
    save_model(file, known.beam, written_by="a test", uncertain=known.stiffness, bench=instruments_of(known))
    return file


def test_band_and_bench_come_back_with_the_model(known: Posterior, model: Path) -> None:
    stored = read_model(model)
    assert stored.bench is not None
    assert stored.bench.as_dict() == instruments_of(known).as_dict()
    assert isinstance(stored.uncertain, UncertainStiffness)
    assert np.array_equal(stored.uncertain.covariance, known.stiffness.covariance)


@pytest.mark.slow
def test_a_plan_in_words(model: Path) -> None:
    found = run("plan", model, "--quiet", "--max-tip-angle-deg", "60")
    assert found.exit_code == 0, found.output
    for words in ("Next pushes", "identified to s = 0.", "best pair with the present bench", "the same once more"):
        assert words in found.stdout, found.stdout


def test_a_plan_for_a_script(model: Path) -> None:
    found = run("plan", model, "--json", "--quiet", "--count", "5", "--max-force-N", "0.3")
    data = json.loads(found.stdout)
    assert data["format"] == "onebend-plan-1"
    assert len(data["proposals"]) == 5
    assert all(one["largest_N"] <= 0.3 for one in data["proposals"] if not one["repeats"])
    assert len(data["pair"]) == 2
    assert len(data["sd_log_k"]) == len(data["s"]) == 101
    assert data["proposals"][0]["after"]["mean_width"] < data["before"]["mean_width"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [["plan"], ["export", "--to", "numpy"], ["damp", "NOWHERE"], ["validate", "NOWHERE"]],
)
def test_a_doubted_model_is_named_wherever_it_is_used(known: Posterior, tmp_path: Path, command: list[str]) -> None:
    name, *more = command
    doubted = replace(known.stiffness, doubts=("the fit did not converge",))
    save_model(tmp_path / "model.json", known.beam, written_by="a test", uncertain=doubted, bench=instruments_of(known))
    out = [] if name in ("plan", "validate") else ["-o", tmp_path / "out"]
    done = run(name, tmp_path / "model.json", *more, *out)
    assert "is NOT TO BE TRUSTED: the fit did not converge." in done.stderr
    assert "NOT TO BE TRUSTED" not in done.stdout


def test_a_trusted_model_is_not_doubted(model: Path, tmp_path: Path) -> None:
    assert run("export", model, "--to", "numpy", "-o", tmp_path / "k.npz").stderr == ""


def test_a_regression_has_nothing_to_plan_from(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", SOFT, written_by="a test")
    found = run("plan", tmp_path)
    assert found.exit_code == 2
    assert found.stdout == ""
    assert "no band on k(s)" in found.stderr.replace("\n", " ")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("tags", [0.3, None, 1.0]),
        ("tags", [0.3, 7.0, 1.0]),
        ("gravity", [0.0]),
        ("shared", ["along", "across", "moon"]),
    ],
)
def test_a_bench_that_no_onebend_wrote_is_named(model: Path, name: str, value: object) -> None:
    data = json.loads(model.read_text(encoding="utf-8"))
    assert name in data["bench"]
    data["bench"][name] = value
    model.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(ResultsError, match=r"key 'bench' .*describes no bench"):
        read_model(model)


def test_a_band_without_end_is_none(model: Path) -> None:
    data = json.loads(model.read_text(encoding="utf-8"))
    data["uncertain"]["covariance"][0][0] = 1e300
    model.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(ResultsError, match="its covariance is none"):
        read_model(model)


@pytest.mark.parametrize(("key", "value"), [("bench", 3), ("bench", {}), ("uncertain", []), ("uncertain", {"mean": 1})])
def test_a_damaged_band_or_bench_is_named(model: Path, key: str, value: object) -> None:
    data = json.loads(model.read_text(encoding="utf-8"))
    model.write_text(json.dumps({**data, key: value}), encoding="utf-8")
    with pytest.raises(ResultsError, match=f"key '{key}'"):
        read_model(model)
