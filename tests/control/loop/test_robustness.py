"""Rehearsals on beams that are not the model."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers, Scaled, Uniform
from onebend.cli import app
from onebend.control.loop import ControllerSettings, controller
from onebend.control.loop_simulation import AXIS_PLACES, LoopCamera, drawn_beams, simulate_trials, wrong_beams
from onebend.errors import ControlError
from onebend.results.model import save_model
from tests import made_up

BEAM = Beam(0.12, Powers((0.03, -0.015)), mass_per_length=Uniform(0.05))
GOAL = BEAM.equilibrium((-0.05, 0.3)).xy(1.0)


@pytest.mark.slow
def test_feedback_takes_off_what_a_wrong_stiffness_leaves() -> None:
    closed = controller(BEAM, GOAL)
    open_loop = controller(BEAM, GOAL, settings=ControllerSettings(feedback=False))
    eye = LoopCamera(noise=0.0)
    good, bad = (
        tuple(simulate_trials(one, wrong_beams(BEAM, 0.3), eye=eye, duration=3.0)) for one in (closed, open_loop)
    )
    assert [one.beam.factor for one in good] == [1.0, 0.7, 1.3]
    assert max(one.steady for one in good) < 3e-4
    assert bad[0].steady < 1e-4
    # Without feedback a softer beam ends where its own equilibrium under the model's force is.
    for one in bad[1:]:
        other = Beam(BEAM.length, Scaled(one.beam.factor, BEAM.stiffness))
        there = other.equilibrium(open_loop.reference.ends).xy(1.0)
        assert one.steady == pytest.approx(float(np.linalg.norm(there - GOAL)), rel=0.02)


@pytest.mark.slow
def test_a_beam_of_unknown_mass_is_given_one() -> None:
    light = Beam(BEAM.length, BEAM.stiffness)
    (only,) = simulate_trials(controller(light, GOAL), wrong_beams(light, 0.0), eye=LoopCamera(noise=0.0), duration=2.5)
    assert only.beam.factor == 1.0
    assert only.steady < 1e-3


@pytest.mark.parametrize(("k_error", "duration"), [(1.0, 8.0), (-0.1, 8.0), (0.3, 1.0)])
def test_what_cannot_be_rehearsed_is_refused(k_error: float, duration: float) -> None:
    with pytest.raises(ControlError):
        next(simulate_trials(controller(BEAM, GOAL), wrong_beams(BEAM, k_error), duration=duration))


def test_gravity_needs_a_mass(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", Beam(BEAM.length, BEAM.stiffness), written_by="a test")
    asked = ["--goal", "0.1", "0.03", "--gravity-m-s2", "0", "-9.81"]
    done = CliRunner().invoke(app, ["reach", str(tmp_path / "model.json"), *asked])
    assert done.exit_code == 2
    assert "the model has no mass" in " ".join(done.output.split())


def test_command_carries_the_weight(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", BEAM, written_by="a test")
    goal = BEAM.equilibrium((0.0, 0.3), gravity=(0.0, -9.81)).xy(1.0)
    asked = ["reach", str(tmp_path / "model.json"), "--goal", *map(str, goal), "--gravity-m-s2", "0", "-9.81", "--json"]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == 0, done.output
    np.testing.assert_allclose(json.loads(done.stdout)["force_N"], (0.0, 0.3), atol=1e-4)


@pytest.mark.slow
def test_drawn_beams_are_those_of_the_band_and_go_their_own_ways() -> None:
    fit = made_up.posterior()
    beam = fit.beam
    goal = beam.equilibrium((0.0, 0.02)).xy(1.0)
    drawn = drawn_beams(beam, fit.stiffness, 1)
    s = np.linspace(0.0, 1.0, 101)
    for one, profile in zip(drawn[1:], fit.stiffness.draw(1, seed=0), strict=True):
        np.testing.assert_array_equal(one.stiffness(s), profile(s))
        assert one.factor == pytest.approx(np.exp(np.mean(np.log(profile(s) / beam.stiffness(s)))))
    still = replace(ControllerSettings(), feedback=False)
    runs = [
        one.run
        for one in simulate_trials(
            controller(beam, goal, settings=still), drawn, eye=LoopCamera(noise=0.0), duration=2.0
        )
    ]
    assert drawn[0].factor == 1.0
    for one, run in zip(drawn, runs, strict=True):
        assert run is not None
        there = replace(beam, stiffness=one.stiffness).equilibrium(run.force[-1])
        np.testing.assert_allclose(run.axis[-1], there.xy(AXIS_PLACES), atol=2e-4)
        np.testing.assert_allclose(run.axis[:, -1], run.xy, atol=1e-12)
