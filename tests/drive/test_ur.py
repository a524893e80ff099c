"""A Universal Robot through the real `ur-rtde`, on the loopback, against the other end of its wires."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from onebend.drive.robots import ToolForce, UniversalRobot, pose_of
from onebend.errors import RecordingError
from onebend.live.sources import HostClock
from tests.drive.other_end import Ask, other_end, wait_for

pytest.importorskip("rtde_control")
ADDRESS = f"127.0.{1 + os.getpid() % 200}.{1 + os.getpid() // 200 % 200}"
NONE, FORCE, END_FORCE, SERVO_STOP, SERVO, WATCHDOG, END = 0, 6, 7, 16, 24, 35, 255  # of the control script
START = [0.4, -0.2, 0.3, 0.0, 3.0, 0.1]


@pytest.fixture
def controller() -> Iterator[Ask]:
    """Asks the other end; it answers with the commands that came since."""
    with other_end("tests.drive.ur_controller", ADDRESS) as ask:
        yield ask


def heard(ask: Ask, code: int) -> dict[str, Any]:
    """The next command of this code."""
    return dict(wait_for(lambda: [one for one in ask()["commands"] if one["code"] == code], f"command {code}")[-1])


def refused(robot: UniversalRobot) -> str:
    """Why it gives no state; a robot needs some milliseconds to say it."""

    def look() -> str:
        try:
            robot.state()
        except ConnectionError as wrong:
            return str(wrong)
        return ""

    return str(wait_for(look, "a refusal"))


def test_poses_forces_and_the_watchdog_arrive(controller: Ask) -> None:
    robot = UniversalRobot(ADDRESS, period=0.008)
    robot.connect(HostClock())
    told = controller()
    assert told["running"]  # the script was uploaded
    assert [one["doubles"] for one in told["commands"] if one["code"] == WATCHDOG] == [[10.0]]  # stops after 0.1 s
    state = robot.state()
    assert state.pose.vector == pytest.approx(START)
    assert state.wrench.tolist() == [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    heard(controller, NONE)  # each state is a sign of life
    robot.command(pose_of([0.41, -0.2, 0.3, 0.0, 3.0, 0.1]))
    assert heard(controller, SERVO)["doubles"] == pytest.approx(
        [0.41, -0.2, 0.3, 0.0, 3.0, 0.1, 0.0, 0.0, 0.008, 0.1, 300.0]
    )
    plane = np.asarray(Rotation.from_euler("xz", [90.0, 30.0], degrees=True).as_matrix())
    robot.command(ToolForce(np.array([0.3, -0.2]), plane, 0.03))
    force = heard(controller, FORCE)
    assert np.asarray(Rotation.from_rotvec(force["doubles"][3:6]).as_matrix()) == pytest.approx(plane)
    assert force["doubles"][6:] == pytest.approx([0.3, -0.2, 0.0, 0.0, 0.0, 0.0, 0.03, 0.03, 0.02, 0.17, 0.17, 0.17])
    assert force["ints"] == [2, 1, 1, 0, 0, 0, 0]
    controller(pose=[0.42, -0.2, 0.3, 0.0, 3.0, 0.1])
    wait_for(lambda: robot.state().pose.position[0] == 0.42)
    robot.hold()  # where it is, and no force any more
    seen = controller()["commands"]
    assert END_FORCE in [one["code"] for one in seen]
    assert seen[-1]["code"] == SERVO or heard(controller, SERVO)
    assert [one["doubles"][0] for one in seen if one["code"] == SERVO] in ([], [0.42])
    robot.release()
    codes = [one["code"] for one in controller()["commands"]]
    assert SERVO_STOP in codes
    assert not controller()["running"]
    robot.close()


@pytest.mark.parametrize(("wrong", "says"), [("stop", "stopped itself"), ("cut", "lost|not heard")])
def test_what_goes_wrong_is_no_answer(controller: Ask, wrong: str, says: str) -> None:
    robot = UniversalRobot(ADDRESS, period=0.008)
    robot.connect(HostClock())
    robot.state()
    controller(**{wrong: True})
    assert any(part in refused(robot) for part in says.split("|"))
    robot.close()


def test_nobody_there_is_said() -> None:
    with pytest.raises(RecordingError, match=r"does not answer.*Is it on, in remote control, and is RTDE allowed"):
        UniversalRobot(ADDRESS, period=0.008).connect(HostClock())
