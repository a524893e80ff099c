"""Goals of tags: in files, for shapes and paths, and by the commands."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from onebend.cli import app
from onebend.control.goals import points, read_goals, read_targets, tags, target_residuals
from onebend.control.path import PathSettings, by_force, follow_goals
from onebend.control.reach import reach_in_setup
from onebend.control.shape import Pusher, shape
from onebend.errors import ControlError
from onebend.results.model import save_model
from tests.beam.test_setup import BEAM, KNOWN, setup, tagged
from tests.control.path.moving_point import point_goals

ONE = replace(tagged(), force_sd=1e-3)
FORCES = np.array([[0.02, 0.1], [0.0, 0.3], [-0.05, 0.4]])
GOALS = ONE.bent(BEAM, KNOWN, FORCES).tags()[:, 1, :2]  # of tag 7


def written(folder: Path, text: str) -> Path:
    file = folder / "goals.csv"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_residuals_of_a_tag_have_its_derivatives() -> None:
    wanted = tags(ONE, [4, 7], [[0.09, 0.02], [0.15, 0.1]]) + points(0.7, [0.1, 0.0])
    state = shape(BEAM, wanted, pushes=(Pusher(1.0),)).state
    here = target_residuals(state.solved, wanted, BEAM.length)
    off = (wanted.places(state.solved)[0] - wanted.xy) / BEAM.length
    np.testing.assert_allclose(here.value[0], np.sqrt(np.tile(wanted.weight, 2)) * off.T.ravel(), atol=1e-12)
    step = 1e-6 * np.random.default_rng(0).standard_normal(len(state.q))
    ends = [target_residuals(replace(state, q=state.q + sign * step).solved, wanted, BEAM.length) for sign in (-1, 1)]
    np.testing.assert_allclose(
        ends[1].value[0] - ends[0].value[0], 2.0 * here.jacobian[0] @ step, rtol=1e-4, atol=1e-11
    )
    b = state.actuators.problem.to_nodes
    curved = step @ b.T @ (here.curvature_term[0] * (b @ step))
    second = (here.jacobian[0] @ step) @ (here.jacobian[0] @ step) + curved
    change = ends[0].cost[0] - 2.0 * here.cost[0] + ends[1].cost[0]
    assert change == pytest.approx(2.0 * second, rel=1e-2)


def test_files_name_tags(tmp_path: Path) -> None:
    rows = "".join(f"{t},{s},{tag},{0.1 + t},0\n" for t in (0, 1) for s, tag in (("", 7), ("0.6", "")))
    found = read_goals(written(tmp_path, "time_s,s,tag,x_m,y_m\n" + rows), setup=ONE)
    np.testing.assert_array_equal(found.targets.s, [1.0, 0.6])
    np.testing.assert_array_equal(found.targets.tag, [7, -1])
    np.testing.assert_allclose(found.targets.offset, [[-5e-4, 7e-4], [0.0, 0.0]])
    read = partial(read_targets, length=0.2, setup=ONE)
    assert read(written(tmp_path, "tag,x_m,y_m\n4,0.1,0\n")).s.tolist() == [0.5]
    for text, says in (
        ("s,tag,x_m,y_m\n0.5,4,0.1,0\n", "line 2: a row has an s, or a tag"),
        ("s,tag,x_m,y_m\n,,0.1,0\n", "line 2: a row has an s, or a tag"),
        ("tag,x_m,y_m\n4.5,0.1,0\n", "line 2: tag is 4.5"),
        ("tag,x_m,y_m\n5,0.1,0\n", "goals.csv: the recording had no tag 5; it had 4, 7"),
    ):
        with pytest.raises(ControlError, match=says):
            read(written(tmp_path, text))
    with pytest.raises(ControlError, match="stands in the set-up of the recording"):
        read_targets(written(tmp_path, "tag,x_m,y_m\n4,0.1,0\n"), 0.2)


def test_the_commands_put_a_tag_on_its_goals(tmp_path: Path) -> None:
    save_model(tmp_path / "model.json", BEAM, written_by="a test", uncertain=KNOWN, setup=ONE)
    rows = [f"{t},{x!r},{y!r}" for t, (x, y) in enumerate(GOALS[1:].tolist())]
    goals = written(tmp_path, "\n".join(["time_s,x_m,y_m", *rows]) + "\n")

    def asked(*words: str) -> dict[str, Any]:
        done = CliRunner().invoke(app, [words[0], str(tmp_path), *words[1:], "--json"])
        assert done.exit_code == 0, done.stderr
        return dict(json.loads(done.stdout))

    x, y = (f"{one!r}" for one in GOALS[1].tolist())
    found = asked("reach", "--goal", x, y, "--tag", "7")
    assert found["tag"] == 7
    np.testing.assert_allclose(found["force_N"], FORCES[1], atol=1e-4)
    asked("path", "--goals", str(goals), "--tag", "7", "--rate-Hz", "4", "-o", str(tmp_path / "out"))
    way = np.genfromtxt(tmp_path / "out" / "path.csv", delimiter=",", names=True)
    led = np.column_stack([way["force_1_x_N"], way["force_1_y_N"]])[[0, 4]]
    there = ONE.bent(BEAM, KNOWN, led).tags()[:, 1, :2]
    assert np.max(np.linalg.norm(there - GOALS[1:], axis=1)) < 1e-4
    held = asked("shape", "--targets", str(written(tmp_path, f"tag,x_m,y_m\n7,{x},{y}\n")))
    there = ONE.bent(BEAM, KNOWN, np.array(held["force_N"])).tags()[0, 1, :2]
    assert np.linalg.norm(there - GOALS[1]) < 1e-4
    for words in (("--tag", "5"), ("--tag", "7", "--beam-alone"), ("--tag", "7", "--moment")):
        refused = CliRunner().invoke(app, ["reach", str(tmp_path), "--goal", x, y, *words])
        assert refused.exit_code == 2
        assert "tag" in refused.stderr


@pytest.mark.slow
def test_a_path_takes_goals_a_hair_out_of_reach() -> None:
    """The length is known to 1 mm: goals half a millimetre beyond it are likely enough, 6 mm are not."""
    sure = setup()
    covariance = sure.covariance.copy()
    covariance[sure.columns["length"], sure.columns["length"]] = 0.005**2
    wide = replace(sure, covariance=covariance)
    ideal, _ = wide.ideal(BEAM, KNOWN)
    forces = np.array([[0.0, 0.02], [0.0, 0.3], [0.0, 0.1]])  # the last can be met, by a great force
    places = ideal.equilibrium(forces).xy(1.0)
    asked = point_goals([0.0, 1.0, 2.0], places + np.array([[5e-4, 0.0], [0.0, 0.0], [5e-4, 0.0]]))
    with pytest.raises(ControlError, match=r"the goal at 0 s.* long"):
        by_force(ideal, asked)
    led = by_force(ideal, asked, learned=(BEAM, KNOWN, wide))
    assert "2 of 3 goals are out of reach" in led.warnings[0]
    off = np.linalg.norm(led.xy[np.searchsorted(led.time, asked.time), 0] - asked.xy[:, 0], axis=1)
    assert np.all(off < 6e-4)
    assert off[1] < 1e-6
    way = follow_goals(ideal, led, pushes=(Pusher(1.0),), settings=PathSettings(rate=20.0))
    assert np.max(np.linalg.norm(way.forces, axis=-1)) < 0.5
    assert way.warnings[0] == led.warnings[0]
    near = reach_in_setup(BEAM, KNOWN, wide, asked.xy[0, 0])
    np.testing.assert_allclose(way.forces[0, 0], near.on_beam, atol=1e-3)
    far = point_goals([0.0, 1.0], places[:2] + np.array([[6e-3, 0.0], [0.0, 0.0]]))
    with pytest.raises(ControlError, match=r"the goal at 0 s"):
        by_force(ideal, far, learned=(BEAM, KNOWN, wide))
