"""A camera of Linux: FFmpeg reads it, before a made-up kernel (`video0.c`) that has one."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from onebend.errors import RecordingError
from onebend.live.sources import HostClock
from onebend.live.specs import camera_of

RAMP = np.tile(np.linspace(20, 230, 64), (48, 1)).astype(np.uint8)
READ = """
import json, sys, time
import numpy as np
from onebend.errors import RecordingError
from onebend.live.sources import End, Frame, HostClock
from onebend.live.specs import camera_of

spec, wanted = sys.argv[1], int(sys.argv[2])
camera, clock = camera_of(spec), HostClock()
try:
    camera.open(clock)
except RecordingError as wrong:
    print(json.dumps({"refused": str(wrong)}))
    sys.exit()
frames, end, none = [], "", 0
while len(frames) < wanted and not end:
    got = camera.read(0.1)
    if isinstance(got, Frame):
        frames.append(got)
    elif isinstance(got, End):
        end = got.why
    else:
        none += 1
camera.close()
print(json.dumps({
    "stamps": [one.stamp for one in frames], "late": [one.arrival - one.stamp for one in frames], "end": end,
    "rows": [one.picture[7].tolist() for one in frames], "shape": frames[0].picture.shape if frames else None,
    "host": camera.timing.host, "none": none,
}))
"""


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    """Reads so many pictures of a spec in another process, whose kernel has a camera; what comes of it."""
    if shutil.which("gcc") is None or not sys.platform.startswith("linux"):
        pytest.skip("no compiler of C")
    folder = tmp_path_factory.mktemp("kernel")
    Image.fromarray(np.stack([RAMP] * 3, axis=-1)).save(folder / "ramp.jpg", quality=95)
    source, library = Path(__file__).with_name("video0.c"), folder / "video0.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)

    def read(spec: str, wanted: int = 5, **camera: int) -> Any:
        made = {"LD_PRELOAD": str(library), "JPEG": str(folder / "ramp.jpg")}
        env = {**os.environ, **made, **{name: str(value) for name, value in camera.items()}}
        command = [sys.executable, "-c", READ, spec, str(wanted)]
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60, check=True)
        return {**json.loads(done.stdout), "asked": done.stderr}

    return read


@pytest.mark.parametrize("packed", ["MJPG", *(pytest.param(one, marks=pytest.mark.slow) for one in ("YUYV", "GREY"))])
def test_pictures_come_with_the_kernels_stamps(kernel: Callable[..., Any], packed: str) -> None:
    got = kernel(f"/dev/video0,size=640x480,fps=60,packed={packed}", 15)
    assert f"asked: 640x480 {packed}" in got["asked"]
    assert "pace: 1/60" in got["asked"]
    assert got["shape"] == [48, 64]  # what the camera gives, not what was asked
    assert np.diff(got["stamps"]) == pytest.approx(1.0 / 30.0, abs=2e-6)
    assert got["host"]
    assert 0.0 <= min(got["late"]) < 0.03
    for row in got["rows"]:
        straight = np.polyfit(RAMP[7], row, 1)
        assert straight[0] == pytest.approx(1.0 if packed != "YUYV" else 255.0 / 219.0, abs=0.05)
        assert np.abs(np.polyval(straight, RAMP[7]) - row).max() < 4.0


def test_broken_pictures_are_left_out(kernel: Callable[..., Any]) -> None:
    got = kernel("/dev/video0", 9, BAD=1)
    assert got["end"] == ""
    steps = np.round(30.0 * np.diff(got["stamps"]))
    assert set(steps) == {1.0, 3.0}
    assert got["none"] > 0


@pytest.mark.slow
def test_another_clock_than_this_machines_is_followed(kernel: Callable[..., Any]) -> None:
    assert not kernel("/dev/video0", 2, OTHER=1000)["host"]


@pytest.mark.slow
def test_a_pulled_cable_and_a_silent_camera_end_it(kernel: Callable[..., Any]) -> None:
    assert "the camera /dev/video0 is gone (No such device" in kernel("/dev/video0", 99, GONE=6)["end"]
    assert kernel("/dev/video0", 99, SILENT=6)["end"] == "the camera /dev/video0 sends no pictures any more"


@pytest.mark.parametrize(
    ("camera", "says"),
    [
        ({"ERRNO": errno.EBUSY}, "Another program has it"),
        pytest.param({"ERRNO": errno.EACCES}, "usermod -aG video", marks=pytest.mark.slow),
        pytest.param({"META": 1}, "Try the other one", marks=pytest.mark.slow),
    ],
)
def test_a_camera_that_refuses_says_what_to_do(kernel: Callable[..., Any], camera: dict[str, int], says: str) -> None:
    assert says in kernel("/dev/video0", **camera)["refused"]


def test_the_spec_is_checked() -> None:
    for spec, says in (
        ("size=big", "size=1280x720"),
        ("packed=H264", "take MJPG or YUYV"),
        ("fps=0", "number from 0.1"),
        ("exposure_ms=5", "v4l2 has no key exposure_ms"),
    ):
        with pytest.raises(RecordingError, match=says):
            camera_of(f"/dev/video0,{spec}")
    with pytest.raises(RecordingError, match="There is no such camera"):
        camera_of("/dev/video99").open(HostClock())
