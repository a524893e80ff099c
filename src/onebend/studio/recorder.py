"""The process that records: `python -m onebend.studio.recorder`, one JSON object of what to do on standard input, then
a line for each `begin` and `stop`.

It does what `onebend record` does, then what `onebend check` does, and says what is known meanwhile as lines of JSON on
standard output. An interrupt stops it, and so does the end of its input: a studio that is gone leaves a whole
recording.
"""

from __future__ import annotations

import base64
import io
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from PIL import Image

from onebend import live
from onebend.errors import OnebendError
from onebend.live.commands import STAGE_NAMES
from onebend.recording.folder import read_recording
from onebend.recording.video import Picture
from onebend.report.overview import overview
from onebend.studio.learned import known_curve
from onebend.text_files import to_json

OFTEN = 0.2  # s between two pictures
WIDEST = 800  # px of a picture that is shown
QUALITY = 60  # of JPEG
_AS_THEY_ARE = (
    *("advice", "displacement", "largest", "half_width", "wider", "until", "seconds", "frames", "drops", "samples"),
    *("lost_samples", "bytes", "disk_left"),
)
_PATIENCE = 3.0  # s for what is still to be said at the end


class Talk:
    """Lines of JSON to the studio, the states by a thread of its own: a studio that is slow never holds up the film."""

    def __init__(self, out: BinaryIO) -> None:
        self._out, self._one = out, threading.Lock()
        self._newest: live.CaptureState | None = None
        self._new, self._over = threading.Event(), False
        self._thread = threading.Thread(target=self._tell_states, daemon=True)
        self._thread.start()

    def tell(self, data: Mapping[str, Any]) -> None:
        """One line; nobody may be there any more to read it."""
        with self._one, suppress(OSError, ValueError):
            self._out.write((to_json(data, ascii_only=True, readable=False) + "\n").encode())
            self._out.flush()

    def watch(self, state: live.CaptureState) -> None:
        """Take a state; of states that come faster than they are sent, the newest counts."""
        self._newest = state
        self._new.set()

    def end(self) -> None:
        """Tell the last state; no other comes."""
        self._over = True
        self._new.set()
        self._thread.join(_PATIENCE)

    def _tell_states(self) -> None:
        told: live.CaptureState | None = None
        while True:
            self._new.wait()
            self._new.clear()
            over, state = self._over, self._newest
            if state is not None and state is not told:
                self.tell(_said(state, told))
                told = state
            if over:
                return
            time.sleep(OFTEN)


def _said(state: live.CaptureState, before: live.CaptureState | None) -> dict[str, Any]:
    """A state as a line; its picture and its curve only where they are new."""
    said: dict[str, Any] = {"state": state_data(state)}
    if state.picture is not None and (before is None or state.picture is not before.picture):
        said["picture"] = base64.b64encode(small_jpeg(state.picture)).decode("ascii")
    if state.stiffness is not None and (before is None or state.stiffness is not before.stiffness):
        said["curve"] = known_curve(state.stiffness)
    return said


def state_data(state: live.CaptureState) -> dict[str, Any]:
    """The state of a recording, for the page."""
    order = list(STAGE_NAMES)
    tags = [
        {"id": tag.id, "side_px": tag.side_px, "corners_px": tag.corners.round(1) if tag.seen else None}
        for tag in state.tags
    ]
    return {
        "stages": list(STAGE_NAMES.values()),
        "stage": order.index(state.stage),
        "size_px": None if state.picture is None else state.picture.shape[::-1],
        "tags": tags,
        "tag_s": sorted({tag.s for tag in state.tags if not tag.on_base}),
        "force_N": state.force,
        "tare_N": state.tare,
        "k_says": "" if state.live is None else state.live.verdict.headline,
        "clock_sd_s": state.clock_sd,
        **{name: getattr(state, name) for name in _AS_THEY_ARE},
    }


def small_jpeg(picture: Picture) -> bytes:
    """A picture (H, W) as JPEG, no wider than `WIDEST`."""
    image = Image.fromarray(picture)
    image = image.reduce(math.ceil(image.width / WIDEST)) if image.width > WIDEST else image
    memory = io.BytesIO()
    image.save(memory, format="JPEG", quality=QUALITY)
    return memory.getvalue()


def settings_of(wanted: Mapping[str, Any]) -> live.CaptureSettings:
    """How the page wants it."""
    until = wanted["until_percent"]
    return live.CaptureSettings(
        until=math.nan if until is None else until / 100.0,
        begin_at_once=wanted["now"],
        follow=not wanted["no_learning"],
        longest=wanted["longest_s"],
        crf=wanted["crf"],
        overwrite=wanted["overwrite"],
    )


def work(wanted: Mapping[str, Any], talk: Talk, stop: threading.Event, begin: threading.Event) -> live.CaptureOutcome:
    """Record, as `onebend record` does. Raises `OnebendError` where nothing could be recorded."""
    try:
        force = live.force_of(wanted["force"]) if wanted["force"] else None
        camera = live.camera_of(wanted["camera"])
        if wanted["like"]:
            live.copy_description(Path(wanted["like"]), Path(wanted["out"]))
        talk.tell({"length_m": read_recording(wanted["out"], filmed=False).beam.length})
        clock = live.PlayedClock() if wanted["fast"] else None
        settings = settings_of(wanted)
        return live.record(wanted["out"], camera, force, settings, talk.watch, stop, begin=begin, clock=clock)
    finally:
        talk.end()


def check_data(folder: Path) -> dict[str, Any]:
    """Findings of `onebend check`."""
    try:
        found = overview(folder)
    except OnebendError as error:
        return {"rows": [], "remarks": [], "faults": [str(error)]}
    remarks = [remark.as_dict() for remark in found.remarks]
    return {"rows": found.rows, "remarks": remarks, "faults": found.faults}


def _lines(handle: int) -> Iterator[str]:
    with open(handle, "rb", buffering=0) as stream:
        while line := stream.readline():
            yield line.decode("utf-8", "replace")


def main() -> int:
    """0: recorded; 2: nothing could be recorded, or a cable or the disk ended it."""
    lines, talk = _lines(os.dup(0)), Talk(os.fdopen(os.dup(1), "wb"))
    nothing = os.open(os.devnull, os.O_RDWR)
    for handle in (0, 1):  # no process that is begun here holds on to the studio's pipes
        os.dup2(nothing, handle)
    stop, begin, gone = threading.Event(), threading.Event(), threading.Event()
    wanted = json.loads(next(lines))

    def obey() -> None:
        for line in lines:
            if (asked := {"begin": begin, "stop": stop}.get(line.strip())) is not None:
                asked.set()
        gone.set()
        stop.set()

    signal.signal(signal.SIGINT, lambda *_: stop.set())
    threading.Thread(target=obey, daemon=True).start()
    os.chdir(wanted["folder"])
    try:
        outcome = work(wanted, talk, stop, begin)
    except OnebendError as error:
        talk.tell({"error": str(error)})
        return 2
    talk.tell({"outcome": live.outcome_data(outcome) | {"fault": outcome.fault, "begun": outcome.film is not None}})
    if outcome.film is not None and not gone.is_set():
        talk.tell({"check": check_data(outcome.folder)})
    return 2 if outcome.film is None or outcome.fault else 0


if __name__ == "__main__":
    sys.exit(main())
