"""Damping and k over mass from a free swing: found back where they are known, and clear words where none can be."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from onebend import cli
from onebend.beam.stiffness import Scaled, UncertainStiffness, Uniform
from onebend.errors import LearningError, ResultsError
from onebend.export.export import export
from onebend.export.sample import rod_sample
from onebend.learning.swing import Damping, DampingSettings, FilmPart, SwingFit, find_swing, learn_damping
from onebend.records import Observations
from onebend.report.sentences import worded
from onebend.results.model import StoredModel, model_text, read_model
from tests.learning.swinging import BEAM, HEAVY, MASS, TAU, released

QUICK = DampingSettings(modes=6)
KNOTS = np.array([0.0] * 4 + [1.0] * 4)


@pytest.fixture(scope="module")
def film() -> Observations:
    return released()


@pytest.fixture(scope="module")
def found(film: Observations) -> SwingFit:
    """Learned with a model that is 10 % too stiff, its band 6 % wide (one sd)."""
    stiff = replace(HEAVY, stiffness=Scaled(1.1, BEAM.stiffness))
    band = UncertainStiffness(KNOTS, np.log(1.1 * np.array([0.03, 0.015, 0.015, 0.03])), 1e-8 * np.eye(4), gain_sd=0.06)
    return learn_damping(stiff, film, uncertain=band, settings=QUICK)


def test_loss_time_and_stiffness_come_back(found: SwingFit) -> None:
    assert found.damping.loss_time == pytest.approx(TAU, rel=0.02)
    assert abs(found.damping.loss_time - TAU) < 4.0 * found.damping.loss_time_sd
    assert found.factor == pytest.approx(1.0 / 1.1, abs=4.0 * found.factor_sd)
    assert found.factor_sd < 0.005
    assert found.model_sd > 0.06  # the gain's, and how the mass may lie
    assert found.rms.max() < 1e-3
    assert not [one for one in worded(found.remarks) if one.level == "warning"]
    assert found.damping.ratio[0] == pytest.approx(np.pi * found.damping.frequency[0] * found.damping.loss_time)


def test_an_unknown_mass_comes_from_the_frequency(film: Observations) -> None:
    fit = learn_damping(BEAM, film, settings=QUICK)
    assert not fit.mass_known
    assert fit.mass == pytest.approx(MASS * BEAM.length, rel=0.01)
    assert fit.beam.mass_per_length(0.3) == pytest.approx(MASS, rel=0.01)
    assert fit.damping.loss_time == pytest.approx(TAU, rel=0.02)
    assert fit.factor == 1.0


def test_a_mass_as_the_width_keeps_its_sum(film: Observations) -> None:
    fit = learn_damping(HEAVY, film, settings=replace(QUICK, mass_along="width"))
    s = np.linspace(0.0, 1.0, 41)
    mass = fit.beam.mass_per_length(s)
    assert np.trapezoid(mass, s) == pytest.approx(MASS, rel=1e-6)
    assert np.allclose(mass / mass[0], np.cbrt(BEAM.stiffness(s) / BEAM.stiffness(0.0)))
    assert fit.factor != pytest.approx(1.0, abs=0.02)  # a mass that lies elsewhere swings at another frequency


def test_the_swing_begins_after_the_release(film: Observations) -> None:
    swing = find_swing(film)
    assert 0.537 < swing.begin < 0.65  # let go at 0.537 s, through rest within the first half swing
    assert find_swing(film, FilmPart(0.9, 1.5)).begin == pytest.approx(0.9, abs=1 / 60)
    assert find_swing(film, FilmPart(0.9, 1.5)).time[-1] == pytest.approx(0.6, abs=2 / 60)


@pytest.mark.parametrize(
    ("change", "part", "says"),
    [
        ({}, FilmPart(1.9), "no frame shows tags"),
        ({"gravity": np.linspace([0.0, 0.0], [9.8, 0.0], 110)}, FilmPart(), "base turns"),
    ],
)
def test_what_is_no_free_swing_is_refused(
    film: Observations, change: dict[str, object], part: FilmPart, says: str
) -> None:
    assert len(film.time) == 110
    with pytest.raises(LearningError, match=says):
        find_swing(replace(film, **change), part)  # type: ignore[arg-type]


@pytest.mark.parametrize("said", [True, False])
def test_tags_that_swing_through_rest_are_free_whatever_the_log_says(film: Observations, said: bool) -> None:
    """A sensor that forgets the load slowly shows contact to the end of the film; without a log there is none."""
    begin = find_swing(replace(film, loaded=np.full(110, said))).begin
    assert 0.537 < begin < 0.65  # let go at 0.537 s, through rest within the first half swing


def test_a_push_that_is_never_let_go_is_no_swing(film: Observations) -> None:
    noise = 5e-5 * np.random.default_rng(1).standard_normal(film.xy.shape)
    held = np.where(film.loaded[:, None, None], film.xy, film.xy[0] + noise)
    for loaded, says in ((np.ones(110, dtype=bool), "pushed to the end"), (np.zeros(110, dtype=bool), "--from-s")):
        with pytest.raises(LearningError, match=says):
            find_swing(replace(film, xy=held, loaded=loaded))


def test_a_still_beam_and_a_slow_camera_are_refused(film: Observations) -> None:
    still = replace(film, xy=film.rest_xy + np.zeros_like(film.xy), angle=film.rest_angle + np.zeros_like(film.angle))
    with pytest.raises(LearningError, match="moves"):
        learn_damping(HEAVY, still, settings=QUICK)
    with pytest.raises(LearningError, match=r"60 frames/s cannot show a swing of 4\d\.\d Hz"):
        learn_damping(replace(HEAVY, mass_per_length=Uniform(MASS / 100)), film, settings=QUICK)


def test_a_model_keeps_its_damping(found: SwingFit, tmp_path: Path) -> None:
    text = model_text(StoredModel(found.beam, None, damping=found.damping), written_by="a test")
    (tmp_path / "model.json").write_text(text, encoding="utf-8")
    assert read_model(tmp_path).damping == found.damping
    assert read_model(tmp_path).beam == found.beam
    for key, value in (("loss_time_s", -1.0), ("ratio", "much"), ("ratio_sd", None), ("frequency_Hz", [])):
        data = json.loads(text)
        data["damping"][key] = value
        (tmp_path / "model.json").write_text(json.dumps(data), encoding="utf-8")
        with pytest.raises(ResultsError, match="key 'damping'"):
            read_model(tmp_path)
    data = json.loads(text) | {"version": 2}
    del data["damping"]
    (tmp_path / "model.json").write_text(json.dumps(data), encoding="utf-8")
    assert read_model(tmp_path).damping is None


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(one) for one in arguments], env={"COLUMNS": "160"})


def test_the_command_writes_what_export_takes(
    found: SwingFit, film: Observations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = type("Read", (), {"folder": tmp_path, "beam": film})()
    monkeypatch.setattr("onebend.cli.learning.read_recording", lambda _: recording)
    monkeypatch.setattr("onebend.cli.learning.observe", lambda *_, **__: film)
    monkeypatch.setattr("onebend.learning.swing.learn_damping", lambda *_, **__: found)
    first, second = tmp_path / "model.json", tmp_path / "with.json"
    first.write_text(model_text(StoredModel(HEAVY, None), written_by="a test"), encoding="utf-8")
    said = run("damp", first, "REC", "-o", second, "-q")
    assert said.exit_code == 0, said.output
    for words in ("loss time", "natural frequency", "k over mass", "agrees with the model"):
        assert words in said.stdout
    assert read_model(second).damping == found.damping
    refused = run("damp", first, "REC", "-o", second, "-q")
    assert (refused.exit_code, "--force" in refused.stderr) == (2, True)
    data = json.loads(run("damp", first, "REC", "--json", "-q").stdout)
    assert data["damping"]["loss_time_s"] == found.damping.loss_time
    assert data["k_over_mass"]["factor"] == found.factor
    assert "damping d / k" in run("show", second).stdout
    assert run("export", second, "--to", "mujoco", "-o", tmp_path / "a.xml").exit_code == 0
    mine = export(rod_sample(found.beam, damping_time=found.damping.loss_time), "mujoco")
    assert (tmp_path / "a.xml").read_text(encoding="utf-8") == mine
    assert run("export", second, "--to", "mujoco", "--damping-time-s", "0.03", "-o", tmp_path / "b.xml").exit_code == 0
    assert (tmp_path / "b.xml").read_text(encoding="utf-8") != mine


@pytest.mark.slow
def test_the_sd_holds_over_many_films() -> None:
    away = []
    for seed in range(12):
        fit = learn_damping(HEAVY, released(seed=seed, noise=1e-4), settings=QUICK)
        away.append((fit.damping.loss_time - TAU) / fit.damping.loss_time_sd)
        away.append((fit.factor - 1.0) / fit.factor_sd)
    assert np.sqrt(np.mean(np.square(away))) < 1.8
    assert np.sqrt(np.mean(np.square(away))) > 0.4


def test_a_damping_is_plain_data() -> None:
    one = Damping(0.004, 0.0001, (4.0, 25.0), 0.01, (0.05, 0.3), 0.001, "a film")
    assert Damping.from_dict(json.loads(json.dumps(one.as_dict()))) == one
