"""Files of paths and targets: what is written comes back, and faults are named with their line."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from onebend.control.goals import Goals, curve, read_goals, read_targets
from onebend.control.path import FollowedPath, PathSettings, follow_goals
from onebend.control.shape import Grip, Pusher
from onebend.control.trajectory_files import write_yaml
from onebend.errors import ControlError
from onebend.results.control_files import write_path
from tests.control.shape.test_shape import SOFT, S, gripped


@pytest.fixture(scope="module")
def way() -> FollowedPath:
    """A push and a grip together."""
    shapes = np.array([gripped(np.array(w), S) for w in ([0.2, 0.3, -0.02], [0.15, 0.35, -0.02])])
    goals = Goals(np.array([0.0, 1.0]), curve(S, shapes[0, :, :2]), shapes[..., :2], np.full((2, 10), np.nan))
    return follow_goals(SOFT, goals, pushes=(Pusher(0.5),), grip=Grip(), settings=PathSettings(rate=50.0))


def test_csv_comes_back(way: FollowedPath, tmp_path: Path) -> None:
    write_path(tmp_path, way, frame="table")
    with (tmp_path / "path.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(way.time) == 51
    np.testing.assert_allclose([float(r["time_s"]) for r in rows], way.time, atol=1e-9)
    np.testing.assert_allclose([float(r["force_1_y_N"]) for r in rows], way.forces[:, 0, 1], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose([float(r["gripper_angle_rad"]) for r in rows], way.poses[:, 2], rtol=1e-8)


@pytest.mark.slow
def test_yaml_is_what_ros_would_read(way: FollowedPath, tmp_path: Path) -> None:
    assert write_yaml(tmp_path, way, frame="table") == [
        "gripper_trajectory.yaml",
        "push_1_wrench.yaml",
        "gripper_wrench.yaml",
    ]
    yaml = YAML(typ="safe")
    one = yaml.load(tmp_path / "gripper_trajectory.yaml")
    assert one["header"]["frame_id"] == "table"
    assert one["joint_names"] == ["gripper"]
    for i in (0, 17, 50):
        point = one["points"][i]
        place, turn = point["transforms"][0]["translation"], point["transforms"][0]["rotation"]
        np.testing.assert_allclose([place["x"], place["y"]], way.poses[i, :2], rtol=1e-12)
        assert 2.0 * np.arctan2(turn["z"], turn["w"]) == pytest.approx(way.poses[i, 2])
        when = point["time_from_start"]
        assert when["sec"] + 1e-9 * when["nanosec"] == pytest.approx(way.time[i], abs=1e-9)
    many = [one for one in yaml.load_all(tmp_path / "push_1_wrench.yaml") if one is not None]
    assert len(many) == len(way.time)
    np.testing.assert_allclose([one["wrench"]["force"]["y"] for one in many], way.forces[:, 0, 1], rtol=1e-12)


def test_targets_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "targets.csv"
    file.write_text("s,x_m,y_m,angle_rad,weight\n0.5,0.07,0.02,,2\n1,,,0.8,1\n", encoding="utf-8")
    found = read_targets(file, 0.15)
    np.testing.assert_array_equal(found.placed, [True, False])
    np.testing.assert_array_equal(found.turned, [False, True])
    np.testing.assert_array_equal(found.weight, [2.0, 1.0])
    file.write_text("x_m,y_m\n0,0\n0.075,0\n0.15,0\n", encoding="utf-8")
    np.testing.assert_allclose(read_targets(file, 0.15).s, [0.0, 0.5, 1.0])


def test_goals_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "goals.csv"
    file.write_text("time_s,x_m,y_m\n0,0.14,0.02\n1,0.13,0.05\n", encoding="utf-8")
    found = read_goals(file, point_s=0.8)
    assert found.targets.s.tolist() == [0.8]
    np.testing.assert_array_equal(found.xy[:, 0], [[0.14, 0.02], [0.13, 0.05]])
    file.write_text("time_s,s,x_m,y_m\n0,0.5,0.07,0\n0,1,0.14,0\n1,0.5,0.07,0.01\n1,1,0.14,0.02\n", encoding="utf-8")
    assert read_goals(file).xy.shape == (2, 2, 2)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time_s,x_m,y_m\n0,0.1,0.1\n1,abc,0.1\n", "line 3: x_m is 'abc'"),
        ("time_s,x_m,y_m\n1,0.1,0.1\n0,0.1,0.1\n", "line 3: the times must rise"),
        ("time_s,x_mm,y_m\n", "line 1: column 'x_mm' is not known"),
        ("x_m,y_m\n0.1,0.1\n", "line 1: no column time_s"),
        ("time_s,x_m,y_m\n0,0.1\n", "line 2: 2 cells, but 3 columns"),
        ("time_s,x_m,y_m\n", "no rows"),
        ("time_s,s,x_m,y_m\n0,1.5,0.1,0.1\n", "line 2: s is 1.5"),
        ("time_s,s,x_m,y_m\n0,1,0.1,0.1\n1,0.5,0.1,0.1\n", "line 3: at 1 s there are other places"),
        ("time_s,x_m,y_m\n0,0.1,\n1,0.1,0.1\n", "both x and y"),
        ("time_s,x_m,y_m\n0,nan,0\n", "leave a cell blank"),
    ],
)
def test_faults_are_named(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "goals.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ControlError) as error:
        read_goals(file)
    assert "goals.csv" in str(error.value)
    assert says in str(error.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(ControlError, match="is not a file"):
        read_targets(tmp_path / "none.csv", 0.1)
