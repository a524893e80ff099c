"""What other packages read: each in place of the real one, with the calls that its documentation names."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from onebend.errors import MissingPackageError, RecordingError
from onebend.live.sources import End, Frame, HostClock, PlayedClock, Samples
from onebend.live.specs import camera_of, force_of


class Hand(HostClock):
    """A clock that is set by hand."""

    passed = 0.0

    def now(self) -> float:
        return self.passed

    def wait_until(self, moment: float) -> None:
        self.passed = max(self.passed, moment)


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Puts a made-up module in the place of a package."""

    def put(name: str, **names: Any) -> None:
        made = ModuleType(name)
        vars(made).update(names)
        monkeypatch.setitem(sys.modules, name, made)

    return put


class UrRobot:
    """`rtde_receive.RTDEReceiveInterface` of ur-rtde: a controller of 500 Hz."""

    def __init__(self, host: str, frequency: float) -> None:
        if host != "robot":
            raise RuntimeError("Timeout connecting to UR dashboard server.")
        assert frequency == 500.0
        self.time, self.connected, self.stands = 100.0, True, False

    def isConnected(self) -> bool:  # noqa: N802
        return self.connected

    def getTimestamp(self) -> float:  # noqa: N802
        self.time += 0.0 if self.stands else 0.002
        return self.time

    def getActualTCPForce(self) -> list[float]:  # noqa: N802
        return [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]

    def getActualTCPPose(self) -> list[float]:  # noqa: N802
        return [0.4, 0.5, 0.6, 0.0, 3.1, 0.0]

    def disconnect(self) -> None:
        self.connected = False


def test_a_universal_robot(module: Any) -> None:
    module("rtde_receive", RTDEReceiveInterface=UrRobot)
    sensor: Any = force_of("ur:robot")
    sensor.open(Hand())
    got = sensor.read(0.01)
    assert isinstance(got, Samples)
    assert np.diff(got.stamp) == pytest.approx(0.002)
    assert got.force[0].tolist() == [1.0, 2.0, 3.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.0, 3.1, 0.0]
    sensor._robot.stands = True
    for _ in range(400):
        if isinstance(stood := sensor.read(0.01), End):
            break
    assert isinstance(stood, End)
    assert "stands still" in stood.why
    sensor._robot.connected = False
    lost = sensor.read(0.01)
    assert isinstance(lost, End)
    assert lost.why == "the robot robot answers no more (the connection was lost)"
    sensor.close()
    with pytest.raises(RecordingError, match="Is it on, and is RTDE allowed"):
        force_of("ur:nobody").open(Hand())


class FrankaArm:
    """`pylibfranka.Robot`: each `read_once` is the state of the next millisecond."""

    def __init__(self, host: str, realtime: str) -> None:
        assert realtime == "kIgnore"
        if host != "arm":
            raise RuntimeError("libfranka: Connection refused")
        self.count = 0

    def read_once(self) -> SimpleNamespace:
        self.count += 1
        if self.count > 30:
            raise RuntimeError("libfranka: UDP receive: Timeout")
        seconds = 0.001 * self.count
        force = np.array([0.5, -0.5, 9.0, 0.0, 0.0, 0.0])
        pose = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.4, 0.5, 0.6, 1.0]  # column by column
        return SimpleNamespace(time=SimpleNamespace(to_sec=lambda: seconds), O_F_ext_hat_K=force, O_T_EE=pose)


def test_a_franka_arm(module: Any) -> None:
    module("pylibfranka", Robot=FrankaArm, RealtimeConfig=SimpleNamespace(kIgnore="kIgnore"))
    sensor = force_of("franka:arm")
    sensor.open(Hand())
    got = sensor.read(0.005)
    assert isinstance(got, Samples)
    assert np.diff(got.stamp) == pytest.approx(0.001)
    wrench, pose = [0.5, -0.5, 9.0, 0.0, 0.0, 0.0], [0.4, 0.5, 0.6, 0.0, 0.0, 0.5 * np.pi]
    assert got.force[-1] == pytest.approx([*wrench, *pose])
    ends = [sensor.read(0.01) for _ in range(10)]
    assert isinstance(ends[-1], End)
    assert "UDP receive: Timeout" in ends[-1].why
    sensor.close()
    with pytest.raises(RecordingError, match="Is FCI active"):
        force_of("franka:nobody").open(Hand())


@pytest.mark.parametrize(
    ("spec", "name", "extra"),
    [
        ("ur:robot", "rtde_receive", "ur"),
        ("franka:arm", "pylibfranka", "franka"),
    ],
)
def test_a_package_that_is_missing_is_named(spec: str, name: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    with pytest.raises(MissingPackageError, match=rf"pip install 'onebend\[{extra}\]'"):
        force_of(spec).open(Hand())


def test_what_ffmpeg_opens() -> None:
    camera = camera_of("av:testsrc=duration=0.2:size=64x48:rate=25,format=lavfi")
    camera.open(PlayedClock())
    got = [camera.read(0.1) for _ in range(6)]
    frames = [one for one in got if isinstance(one, Frame)]
    assert [frame.stamp for frame in frames] == pytest.approx([0.0, 0.04, 0.08, 0.12, 0.16])
    assert frames[0].picture.shape == (48, 64)
    assert isinstance(got[-1], End)
    camera.close()
    with pytest.raises(RecordingError, match="knows no dshow2"):
        camera_of("av:video=USB,format=dshow2").open(PlayedClock())
    with pytest.raises(RecordingError, match="cannot be opened as a camera"):
        camera_of("av:/nowhere").open(PlayedClock())
