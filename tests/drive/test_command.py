"""`onebend drive`: the plan, what is refused, and a drive with all that it shows."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from onebend.cli import app
from onebend.drive import commands, specs
from onebend.drive.plan import DriveSettings
from onebend.drive.robots import FCI, FrankaArm, pose_of
from onebend.drive.run import drive
from onebend.drive.specs import robot_of
from onebend.drive.virtual import VirtualCell, VirtualSetup
from onebend.errors import MissingPackageError, RecordingError
from onebend.live.sources import HostClock, PlayedClock
from onebend.recording.folder import read_recording
from onebend.results.model import save_model
from tests.drive.cells import CellCamera, CellRobot, described, model_of, setup_for

LIMITS = ("--max-force-N", "1.2", "--max-curvature-per-m", "60", "--max-speed-mm-per-s", "60", "--rest-s", "0.5")


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A model and a recording.toml."""
    save_model(tmp_path / "model.json", model_of("linear").beam, written_by="a test")
    described(tmp_path / "like", width=640)
    return tmp_path


def asked(bench: Path, *words: str, goal: tuple[float, float] | None = None) -> Result:
    x, y = goal or tuple(np.asarray(model_of("linear").beam.equilibrium((0.0, 0.3)).xy(1.0)).reshape(2).tolist())
    where = [str(bench / "model.json"), str(bench / "out"), "--like", str(bench / "like")]
    return CliRunner().invoke(app, ["drive", *where, "--goal", str(x), str(y), *words], env={"COLUMNS": "100"})


def test_without_go_the_plan_is_shown_and_nothing_moves(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "run", lambda *_a, **_k: pytest.fail("it moved"))
    done = asked(bench, *LIMITS, "--robot", "virtual:linear")
    assert done.exit_code == 0, done.output
    assert "0.3 N at 90 deg" in done.output
    assert "Nothing moved. To move, add --go." in done.output
    assert not (bench / "out").exists()
    data = json.loads(asked(bench, *LIMITS, "--json").stdout)
    assert data["moved"] is False
    assert data["plan"]["limits"]["force_N"] == 1.2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "nothing tells how far this beam was ever bent: give --max-force-N"),
        ((*LIMITS, "--go"), "--robot is missing"),
        ((*LIMITS, "--go", "--robot", "ros2:0"), "--camera is missing"),
        ((*LIMITS, "--robot", "arm:1"), "arm"),
        ((*LIMITS, "--robot", "franka:1", "--by", "force"), "cannot be asked for it"),
        ((*LIMITS, "--robot", "virtual:nothing"), "is no design"),
        ((*LIMITS, "--place", "tag"), "--tool-tag"),
        (("--max-force-N", "60"), "--max-force-N"),
        (("--max-speed-mm-per-s", "900"), "--max-speed-mm-per-s"),
    ],
)
def test_what_cannot_be_is_refused(words: tuple[str, ...], says: str, bench: Path) -> None:
    done = asked(bench, *words)
    assert done.exit_code == 2
    assert says in " ".join(done.output.split())
    assert "Traceback" not in done.output
    assert not (bench / "out").exists()


@pytest.mark.parametrize(
    ("sensor", "spec", "white"),
    [
        ("", "virtual:linear", 0.005),
        ("franka-estimate", "virtual:linear", 0.014),
        ("", "virtual:linear,white_N=1", 1.0),
    ],
)
def test_a_virtual_robot_has_the_noise_of_the_stated_sensor(
    sensor: str, spec: str, white: float, bench: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    setups: list[VirtualSetup] = []
    monkeypatch.setattr(specs, "VirtualRobot", setups.append)
    rec = read_recording(bench / "like", filmed=False)
    assert rec.force is not None
    robot_of(spec)(replace(rec, force=replace(rec.force, sensor=sensor)), DriveSettings())
    assert setups[0].white == white


def test_a_goal_beyond_reach_names_the_nearest(bench: Path) -> None:
    done = asked(bench, *LIMITS, goal=(0.2, 0.1))
    assert done.exit_code == 2
    assert "nearest reachable" in " ".join(done.output.split())


@pytest.mark.slow  # the studio drives so as well: tests/studio/test_driving.py
def test_a_drive_says_what_it_does(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command itself, with a cell on a played clock in the place of the virtual process."""
    rec = read_recording(bench / "like", filmed=False)
    cell = VirtualCell(setup_for(rec, holds=False, sees=math.radians(60.0)))
    monkeypatch.setattr(specs, "robot_of", lambda _spec: lambda _rec, _settings: CellRobot(cell))
    monkeypatch.setattr(specs, "camera_of", lambda _spec: CellCamera(cell))
    monkeypatch.setattr(commands, "run", partial(drive, clock=PlayedClock(), beside=False, setup=0.15))
    done = asked(bench, *LIMITS, "--robot", "virtual:linear", "--camera", "a", "--go")
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert "goal 1 of 1 is reached" in said
    assert "reached, seen" in said
    assert "learn from it with: onebend learn" in said
    again = asked(bench, *LIMITS, "--robot", "virtual:linear", "--camera", "a", "--go")
    assert again.exit_code == 2
    assert "recording.toml exists" in " ".join(again.output.split())


# A Franka arm, in the place of pylibfranka.


class Arm:
    """`pylibfranka.Robot`: an arm that is where it was sent a millisecond ago."""

    def __init__(self, host: str) -> None:
        if host != "arm":
            raise RuntimeError("libfranka: Connection refused")
        self.at, self.pose, self.sent, self.stiff = 0.0, np.eye(4), list[Any](), list[float]()
        self.pose[:3, 3] = (0.4, 0.0, 0.3)

    def set_cartesian_impedance(self, stiff: list[float]) -> None:
        self.stiff = stiff

    def read_once(self) -> SimpleNamespace:
        self.at += FCI
        columns = self.pose.T.reshape(-1).tolist()
        time = SimpleNamespace(to_sec=lambda at=self.at: at)
        return SimpleNamespace(
            time=time, O_T_EE=columns, O_T_EE_c=columns, O_F_ext_hat_K=[0.1, 0.2, 0.3, 0.0, 0.0, 0.0]
        )

    def start_cartesian_pose_control(self, mode: str) -> SimpleNamespace:
        assert mode == "impedance"
        return SimpleNamespace(readOnce=lambda: (self.read_once(), None), writeOnce=self.write)

    def write(self, wanted: SimpleNamespace) -> None:
        self.pose = np.array(wanted.O_T_EE).reshape(4, 4).T
        self.sent.append(wanted)
        if len(self.sent) > 500_000:
            raise RuntimeError("enough")


@pytest.fixture
def pylibfranka(monkeypatch: pytest.MonkeyPatch) -> None:
    made = ModuleType("pylibfranka")
    pose = lambda columns: SimpleNamespace(O_T_EE=columns, motion_finished=False)  # noqa: E731
    modes = SimpleNamespace(CartesianImpedance="impedance", JointImpedance="joints")
    vars(made).update(Robot=Arm, CartesianPose=pose, ControllerMode=modes)
    monkeypatch.setitem(sys.modules, "pylibfranka", made)


@pytest.mark.usefixtures("pylibfranka")
def test_a_franka_arm_follows_smoothly_and_ends_its_motion() -> None:
    arm: Any = FrankaArm("arm")
    arm.connect(HostClock())
    assert arm.state().wrench.tolist() == [0.1, 0.2, 0.3, 0.0, 0.0, 0.0]
    robot = arm._robot
    assert robot.stiff == [1500.0] * 3 + [100.0] * 3
    wanted = pose_of([0.41, 0.0, 0.3, 0.0, 0.1, 0.0])
    arm.command(wanted)
    while np.linalg.norm(arm.state().pose.position - wanted.position) > 1e-5:
        assert len(robot.sent) < 400_000
    places = np.array([np.array(one.O_T_EE).reshape(4, 4).T[:3, 3] for one in robot.sent])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= 0.25 * FCI * (1.0 + 1e-9)
    arm.release()
    assert robot.sent[-1].motion_finished
    assert not any(one.motion_finished for one in robot.sent[:-1])
    arm.close()
    with pytest.raises(RecordingError, match=r"does not answer.*Is FCI active"):
        FrankaArm("nobody").connect(HostClock())


def test_the_real_pylibfranka_has_the_names() -> None:
    real = pytest.importorskip("pylibfranka")
    for name in ("read_once", "set_cartesian_impedance", "start_cartesian_pose_control"):
        assert hasattr(real.Robot, name)
    assert {"readOnce", "writeOnce"} <= set(dir(real.ActiveControlBase))
    assert {"CartesianImpedance", "JointImpedance"} <= set(dir(real.ControllerMode))
    assert {"O_T_EE", "O_T_EE_c", "O_F_ext_hat_K", "time"} <= set(dir(real.RobotState))
    pose = real.CartesianPose(np.eye(4).reshape(-1).tolist())
    pose.motion_finished = True
    assert pose.motion_finished


@pytest.mark.parametrize(
    ("spec", "module", "extra"), [("ur:robot", "rtde_control", "ur"), ("franka:arm", "pylibfranka", "franka"),
                                  ("ros2:0", "cyclonedds.domain", "ros2")],
)  # fmt: skip
def test_a_missing_package_names_its_extra(spec: str, module: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    made = robot_of(spec)(None, SimpleNamespace(rate=125.0))  # type: ignore[arg-type]
    with pytest.raises(MissingPackageError, match=rf"onebend\[{extra}\]"):
        made.connect(HostClock())
