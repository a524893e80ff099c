"""The parts of a drive: plan and limits, the robot's place, the delay, the point between tags, the virtual hand."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings as hypothesis, strategies as some
from scipy.spatial.transform import Rotation

from onebend.beam.model import Beam
from onebend.beam.stiffness import Powers
from onebend.drive.placing import Placement, fitted, from_recording, stated_placement
from onebend.drive.plan import DriveLimits, DriveSettings, gravity_of, make_plan, plan_data, plan_rows, read_wanted
from onebend.drive.robots import FCI, SmoothFollower, ToolForce, ToolPose, pose_of
from onebend.drive.seeing import DelayMeter, SeenBeam, point_between
from onebend.errors import ControlError, ObservationError, RecordingError
from onebend.learning.instruments import instruments_of
from onebend.recording.entries import Recording
from onebend.recording.folder import read_recording
from onebend.results.model import StoredModel
from tests import made_up
from tests.drive.cells import LENGTH, QUICK, BlindCell, described, model_of, planned, recorded_push, setup_for


@pytest.fixture
def rec(tmp_path: Path) -> Recording:
    return read_recording(described(tmp_path, width=640), filmed=False)


def goal_of(force: tuple[float, float] = (0.0, 0.3), at_s: float = 1.0) -> tuple[float, float]:
    x, y = np.asarray(model_of("linear").beam.equilibrium(force, at_s).xy(at_s)).reshape(2)
    return float(x), float(y)


# The plan.


@pytest.mark.slow
def test_a_plan_is_what_the_beam_needs(rec: Recording) -> None:
    plan = planned(rec, [goal_of()])
    assert plan.force == pytest.approx([0.0, 0.3], abs=1e-6)
    there = model_of("linear").beam.equilibrium((0.0, 0.3), 1.0)
    assert plan.hand[-1, :2] == pytest.approx(np.asarray(there.xy(1.0)).reshape(2), abs=1e-6)
    assert plan.hand[0] == pytest.approx([LENGTH, 0.0, 0.0])
    rise = plan.goals[0].control.reference.rise
    way = float(np.sum(np.linalg.norm(np.diff(plan.hand[:, :2], axis=0), axis=1)))
    assert 1.875 * way / rise <= plan.limits.speed * (1.0 + 1e-9)  # the quintic's largest speed
    rows = dict(plan_rows(plan))
    assert "0.3 N at 90 deg" in rows["force"]
    assert "1.2 N, 60 mm/s" in rows["limits"]
    assert plan_data(plan)["limits"]["force_N"] == 1.2


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        ({"force": 0.2}, "0.2 N"),
        ({"curvature": 5.0}, "1/m are allowed"),
        ({"margin": 0.9999999}, "margin of"),
    ],
)
def test_no_plan_goes_beyond_a_limit(limits: dict[str, float], says: str, rec: Recording) -> None:
    goal = goal_of((-0.12, 0.3))
    planned(rec, [goal])
    with pytest.raises(ControlError, match=says):
        planned(rec, [goal], settings=replace(QUICK, limits=replace(QUICK.limits, **limits)))


def test_limits_are_always_known(rec: Recording) -> None:
    with pytest.raises(ControlError, match="nothing tells how far this beam was ever bent: give --max-force-N"):
        planned(rec, [goal_of()], settings=DriveSettings())
    fit = made_up.posterior()
    stored = StoredModel(fit.beam, None, fit.stiffness, instruments_of(fit))
    assert stored.bench is not None
    goal = np.asarray(fit.beam.equilibrium((0.0, 0.1)).xy(1.0)).reshape(2)
    plan = make_plan(stored, replace_length(rec, fit.beam), [(math.nan, goal)], stated_placement(rec))
    assert plan.limits.force == pytest.approx(1.2 * max(one.largest for one in stored.bench.pushes))
    assert plan.open_loop is not None
    assert np.all(np.isfinite(plan.force_spread()))


def replace_length(rec: Recording, beam: Beam) -> Recording:
    return replace(rec, beam=replace(rec.beam, length=beam.length))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"hand": "hold", "at_s": 0.8}, "holds its end"),
        ({"hand": "hold", "by": "force"}, "led by its pose"),
        ({"delay": 0.2}, "longer than --longest-delay-ms"),
        ({"hand": "hold", "learn": True}, "moment"),
    ],
)
def test_settings_that_contradict_each_other(change: dict[str, Any], says: str, rec: Recording) -> None:
    at_s = change.pop("at_s", 1.0)
    with pytest.raises(ControlError, match=says):
        planned(rec, [goal_of(at_s=at_s)], settings=replace(QUICK, **change), at_s=at_s, point_s=at_s)


def test_goals_are_asked_for_once(rec: Recording, tmp_path: Path) -> None:
    stored, where = model_of("linear"), {"push_s": 1.0, "point_s": 1.0, "gravity": (0.0, 0.0)}
    limits = DriveLimits(force=1.0, curvature=50.0)
    given: dict[str, Any] = {"goal": None, "goals": None, "targets": None} | where
    with pytest.raises(ControlError, match="say what to do, once"):
        read_wanted(stored, limits, **given)
    goals = tmp_path / "goals.csv"
    x, y = goal_of()
    goals.write_text(f"time_s,x_m,y_m\n2.0,{x},{y}\n5.0,{x},{-y}\n", encoding="utf-8")
    timed = read_wanted(stored, limits, **(given | {"goals": goals}))
    assert [time for time, _ in timed] == [0.0, 3.0]
    assert timed[1][1] == pytest.approx([x, -y])
    shape = tmp_path / "shape.csv"
    shape.write_text(f"s,x_m,y_m\n1.0,{x},{y}\n", encoding="utf-8")
    (wanted,) = read_wanted(stored, limits, **(given | {"targets": shape}))
    assert wanted[1] == pytest.approx([x, y], abs=1e-4)
    assert gravity_of(rec) == (0.0, 0.0)


# Where the robot stands.

TURNS = some.tuples(*[some.floats(-0.03, 0.03)] * 3)


@given(turn=TURNS, tilt=some.floats(-3.0, 3.0), seed=some.integers(0, 999))
@hypothesis(max_examples=25, deadline=None)
def test_a_push_tells_where_the_beam_stands(turn: tuple[float, float, float], tilt: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = np.asarray(Rotation.from_rotvec([0.3 * tilt, tilt, 0.2]).as_matrix())
    true = Placement(axes, np.array([0.4, -0.2, 0.3]), np.zeros((6, 6)), np.zeros(3), 0.0, "the truth")
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = 0.02**2 * np.eye(3)
    off = np.asarray(Rotation.from_rotvec(turn).as_matrix() @ axes)
    prior = Placement(off, np.zeros(3), covariance, np.zeros(3), 0.0, "the axes")
    seen = np.column_stack([0.15 - 0.02 * np.linspace(0, 1, 60) ** 2, 0.09 * np.linspace(0, 1, 60)])
    tool = [ToolPose(true.to_base(xy) + 1e-4 * rng.standard_normal(3), np.eye(3)) for xy in seen]
    found = fitted(seen, tool, prior, 0.003, "a push")
    away = np.linalg.norm(found.to_base(seen[-1]) - true.to_base(seen[-1]))
    assert away < 5e-3
    assert found.sd(seen[-1]) < 4e-3
    assert found.to_beam(found.to_base(seen[7])) == pytest.approx([*seen[7], 0.0], abs=1e-12)
    ways = found.to_base(seen[-1]) - found.to_base(seen[0]) - (true.to_base(seen[-1]) - true.to_base(seen[0]))
    assert np.linalg.norm(ways[:2]) < 5e-4 or np.linalg.norm(ways) < 2e-3


def test_a_push_that_contradicts_the_axes_is_refused(rec: Recording) -> None:
    prior = stated_placement(rec)
    seen = np.column_stack([np.full(60, 0.15), 0.09 * np.linspace(0, 1, 60)])
    tool = [pose_of([0.4, 0.1 - 0.09 * share, 0.2, 0.0, 0.0, 0.0]) for share in np.linspace(0, 1, 60)]
    with pytest.raises(RecordingError, match="disagree on where the tool went"):
        fitted(seen, tool, prior, 0.003, "a push")


@pytest.mark.slow
def test_a_recorded_push_places_the_robot(tmp_path: Path) -> None:
    folder = described(tmp_path)
    off = (0.02, -0.01, 0.015)
    setup = setup_for(read_recording(folder, filmed=False), holds=False, off=off)
    recorded_push(folder, setup)
    rec = read_recording(folder)
    found, stated = from_recording(rec), stated_placement(rec)
    true = Rotation.from_rotvec(off).as_matrix()
    turned = [Rotation.from_matrix(one.rotation.T @ true).as_rotvec() for one in (found, stated)]
    assert abs(turned[0][2]) < 0.005 < abs(turned[1][2])  # in the plane of bending, where it counts
    assert found.to_base(np.array([LENGTH, 0.0])) == pytest.approx(setup.base + LENGTH * true[:, 0], abs=2e-3)
    described_as = (folder / "recording.toml").read_text(encoding="utf-8")
    on_tool = described_as.replace(", { id = 3, s = 1.0 }", "")  # the tag at the tip, where the tool is
    (folder / "recording.toml").write_text(on_tool, encoding="utf-8")
    by_tag = from_recording(read_recording(folder), tool_tag=3)
    assert by_tag.source == f"tag 3 on the tool of {rec.name}"
    assert abs(Rotation.from_matrix(by_tag.rotation.T @ true).as_rotvec()[2]) < 0.008  # the tag turns with the beam
    assert by_tag.to_base(np.array([LENGTH, 0.0])) == pytest.approx(setup.base + LENGTH * true[:, 0], abs=2e-3)
    with pytest.raises(ObservationError, match="tag 9 is in none of"):
        from_recording(read_recording(folder), tool_tag=9)
    (folder / "recording.toml").write_text(described_as, encoding="utf-8")
    log = folder / "force.csv"
    lines = [",".join(line.split(",")[:4]) for line in log.read_text(encoding="utf-8").splitlines()]
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"no column x_m.*--place start"):
        from_recording(read_recording(folder))


# What is seen.


@pytest.mark.parametrize("delay", [0.04, 0.087, 0.15])
def test_the_delay_is_measured_while_the_beam_moves(delay: float) -> None:
    meter, rng = DelayMeter(0.06), np.random.default_rng(0)

    def way(time: float) -> np.ndarray[Any, np.dtype[np.float64]]:
        share = min(max((time - 0.5) / 2.0, 0.0), 1.0)
        return 0.05 * (10 * share**3 - 15 * share**4 + 6 * share**5) * np.array([-0.3, 1.0])

    for turn in range(400):
        now = 0.008 * turn
        meter.told(now, way(now))
        if turn % 4 == 0:
            meter.shown(now, 1.3 * way(now - delay) + 5e-5 * rng.standard_normal(2), 5e-5)
    assert meter.delay == pytest.approx(delay, abs=0.004)
    assert meter.sd < 0.004


def test_a_point_between_tags_is_seen_by_its_neighbours() -> None:
    model, true = Beam(LENGTH, Powers((0.05,))), Beam(LENGTH, Powers((0.04,)))
    s = np.array([1 / 3, 2 / 3, 1.0, 0.8])
    bent = [beam.equilibrium((0.0, 0.3), 1.0) for beam in (model, true)]
    poses = [np.column_stack([np.asarray(one.xy(s)).reshape(-1, 2), np.ravel(one.angle(s))]) for one in bent]
    seen = SeenBeam(0.0, poses[1][:3, :2], poses[1][:3, 2], 1e-8 * np.tile(np.eye(3), (3, 1, 1)))
    point, sd = point_between(seen, s, poses[0], LENGTH)
    assert point == pytest.approx(poses[1][3, :2], abs=2e-5)
    assert np.linalg.norm(poses[0][3, :2] - poses[1][3, :2]) > 2e-3
    assert sd == pytest.approx(1e-4)
    hidden = replace(seen, xy=np.where(np.arange(3)[:, None] == 2, np.nan, seen.xy))
    assert np.isnan(point_between(hidden, s[[0, 1, 2, 2]], poses[0][[0, 1, 2, 2]], LENGTH)[0]).all()


# The virtual bench, and a pose that follows another.


@pytest.mark.parametrize("at_s", [1.0, 0.8])
def test_the_virtual_hand_finds_the_force_of_the_beam(at_s: float, tmp_path: Path) -> None:
    rec = read_recording(described(tmp_path, at_s=at_s, width=640), filmed=False)
    cell = BlindCell(setup_for(rec, holds=False, at_s=at_s, off=(0.0, 0.0, 0.0)))
    place = stated_placement(rec).moved_to(cell.state().pose.position, cell.hand[:2])
    for step in range(1, 26):  # a straight way would press the beam lengthwise
        x, y = goal_of((0.0008 * step, 0.01 * step), at_s)
        cell.command(ToolPose(place.to_base(np.array([x, y])), cell.state().pose.rotation))
        cell.advance(0.1 * step)
    cell.advance(3.0)
    here = cell.poses[cell._node]
    assert here[:2] + cell.setup.give * cell.wrench == pytest.approx([x, y], abs=1e-5)
    across = np.array([-math.sin(here[2]), math.cos(here[2])])  # along the beam a hair's breadth makes any force
    assert cell.wrench @ across == pytest.approx(np.array([0.02, 0.25]) @ across, abs=0.01)
    cell.command(ToolForce(np.array([-0.03, 0.2]), place.rotation, 0.05))
    cell.advance(6.0)
    assert cell.wrench == pytest.approx([-0.03, 0.2], abs=1e-3)
    assert cell.poses[cell._node, :2] == pytest.approx(goal_of((-0.03, 0.2), at_s), abs=2e-4)


@pytest.mark.slow
def test_the_follower_keeps_its_bounds() -> None:
    follower = SmoothFollower(pose_of([0.0] * 6))
    wanted = pose_of([0.1, 0.0, 0.0, 0.0, 0.0, 0.5])
    places, turns = [], []
    for _ in range(3000):
        places.append(follower.step(wanted, FCI).position.copy())
        turns.append(Rotation.from_matrix(follower.pose.rotation).magnitude())
    speed = np.diff(np.array(places)[:, 0]) / FCI
    assert speed.max() <= 0.25 + 1e-9
    assert np.abs(np.diff(speed)).max() / FCI <= 2.0 + 1e-6
    assert np.abs(np.diff(np.diff(turns))).max() / FCI**2 <= 8.0 * 1.05
    assert follower.pose.vector == pytest.approx(wanted.vector, abs=1e-4)
    assert max(places, key=lambda one: float(one[0]))[0] < 0.102  # critically damped: hardly beyond
    assert follower.still
