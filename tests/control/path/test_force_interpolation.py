"""A way from goal to goal that one force can go."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.beam.model import Beam
from onebend.beam.stiffness import Table
from onebend.cli import app
from onebend.control.goals import Goals
from onebend.control.path import PathSettings, by_force, follow_goals
from onebend.control.shape import Pusher
from onebend.errors import ControlError
from onebend.results.model import save_model
from tests.control.path.moving_point import point_goals

BEAM = Beam(0.15, Table((0.0, 1.0), (0.03, 0.012)))
FORCES = np.array([[0.0, 0.05], [0.02, 0.2], [-0.05, 0.4]])


def goals() -> Goals:
    return point_goals([0.0, 0.4, 1.0], BEAM.equilibrium(FORCES).xy(1.0))


@pytest.mark.slow
def test_every_goal_between_is_within_reach_and_the_forces_come_back() -> None:
    led = by_force(BEAM, goals())
    way = follow_goals(BEAM, led, pushes=(Pusher(1.0),), settings=PathSettings(rate=100.0))
    assert np.max(way.miss) < 1e-5 * BEAM.length
    np.testing.assert_allclose(way.forces[[0, 40, 100], 0], FORCES, atol=1e-5)
    np.testing.assert_allclose(way.xy([1.0])[[0, 40, 100], 0], goals().xy[:, 0], atol=1e-8)


def test_goals_out_of_reach_and_of_more_than_a_point_are_refused() -> None:
    with pytest.raises(ControlError, match=r"the goal at 1 s: "):
        by_force(BEAM, point_goals([0.0, 1.0], [goals().xy[0, 0], [0.2, 0.0]]))
    with pytest.raises(ControlError, match=r"the goal at 0.4 s: .*0.1 N"):
        by_force(BEAM, goals(), max_force=0.1)


def test_the_command_leads_the_tip_through_few_goals(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", BEAM, written_by="a test")
    rows = [
        f"{t},{x!r},{y!r}" for t, (x, y) in zip((0.0, 1.0, 2.0), BEAM.equilibrium(FORCES).xy(1.0).tolist(), strict=True)
    ]
    (tmp_path / "goals.csv").write_text("\n".join(["time_s,x_m,y_m", *rows]) + "\n", encoding="utf-8")
    common = ["path", str(tmp_path), "--goals", str(tmp_path / "goals.csv"), "--rate-Hz", "50"]
    done = CliRunner().invoke(app, [*common, "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.stderr
    refused = CliRunner().invoke(app, [*common, "--grip", "--between", "force"])
    assert refused.exit_code == 2
    assert "for one push" in refused.stderr
