"""A recorder that is killed leaves a folder that can be checked, with all but the last second."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from onebend.recording.folder import read_recording
from onebend.recording.force import read_log
from onebend.recording.video import read_frames
from onebend.report.overview import overview

EXAMPLE = Path(__file__).parents[2] / "examples" / "linear-beam" / "train"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
@pytest.mark.parametrize("after", [2.3, 4.1])
def test_a_killed_recorder_loses_less_than_a_second(tmp_path: Path, after: float) -> None:
    folder = tmp_path / "push"
    specs = ("--camera", f"film:{EXAMPLE}", "--force", f"log:{EXAMPLE}", "--now", "--no-learning", "--quiet")
    command = [sys.executable, "-m", "onebend", "record", str(folder), "--like", str(EXAMPLE), *specs]
    recorder = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    frames = folder / "frames.csv"  # a slow machine takes seconds from its first line to its first frame
    while not (frames.exists() and frames.read_text().count("\n") > 1) and recorder.poll() is None:
        time.sleep(0.05)
    begun = time.monotonic()
    time.sleep(after)
    os.kill(recorder.pid, signal.SIGKILL)
    lasted = time.monotonic() - begun
    recorder.wait()
    assert overview(folder).faults == ()
    rec = read_recording(folder)
    assert rec.video is not None
    times = np.array([frame.time for frame in read_frames(rec.video)])
    assert times[-1] > lasted - 1.0
    log = read_log(rec)
    assert log is not None
    assert log.time[-1] > lasted - 1.0
