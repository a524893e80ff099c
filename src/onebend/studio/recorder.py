"""The recording process, `python -m onebend.studio.recorder`, with one JSON object on standard input, then lines
`begin` and `stop`.

It does what `onebend record` and then `onebend check` do, with JSON lines on standard output. An interrupt or the end
of its input stops it, with a complete recording.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

from PIL import Image

from onebend import live
from onebend.errors import OnebendError
from onebend.live.commands import STAGE_NAMES
from onebend.recording.folder import read_recording
from onebend.report.overview import overview
from onebend.studio.jobs import tell
from onebend.studio.learned import known_curve
from onebend.studio.recordings import jpeg_in

OFTEN = 0.2  # s between pictures
WIDEST = 800  # px
QUALITY = 60  # of JPEG
_AS_THEY_ARE = (
    *("advice", "displacement", "largest", "half_width", "wider", "until", "seconds", "frames", "drops", "samples"),
    *("lost_samples", "bytes", "disk_left"),
)
_PATIENCE = 3.0  # s for the last messages


class Talk:
    """JSON lines to the studio from a separate thread, so that a slow studio never delays the film."""

    def __init__(self, out: TextIO, said: Callable[[Any, Any], Mapping[str, Any]]) -> None:
        """`said`: a state as a line, from it and the one told before (None: the first)."""
        self._out, self._one, self._said = out, threading.Lock(), said
        self._newest: Any = None
        self._new, self._over = threading.Event(), False
        self._thread = threading.Thread(target=self._tell_states, daemon=True)
        self._thread.start()

    def tell(self, data: Mapping[str, Any]) -> None:
        with self._one:
            tell(data, self._out)

    def watch(self, state: Any) -> None:
        """Of fast states the newest counts."""
        self._newest = state
        self._new.set()

    def end(self) -> None:
        """Sends the last state."""
        self._over = True
        self._new.set()
        self._thread.join(_PATIENCE)

    def _tell_states(self) -> None:
        told: Any = None
        while True:
            self._new.wait()
            self._new.clear()
            over, state = self._over, self._newest
            if state is not None and state is not told:
                self.tell(self._said(state, told))
                told = state
            if over:
                return
            time.sleep(OFTEN)


def capture_line(state: live.CaptureState, before: live.CaptureState | None) -> dict[str, Any]:
    """A state as a line; picture and curve only if new."""
    said: dict[str, Any] = {"state": state_data(state)}
    if state.picture is not None and (before is None or state.picture is not before.picture):
        said["picture"] = jpeg_in(Image.fromarray(state.picture), WIDEST, QUALITY)
    if state.stiffness is not None and (before is None or state.stiffness is not before.stiffness):
        said["curve"] = known_curve(state.stiffness)
    return said


def state_data(state: live.CaptureState) -> dict[str, Any]:
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
        "outline_px": state.outline.round(1),
        "tag_s": sorted({tag.s for tag in state.tags if not tag.on_base}),
        "force_N": state.force,
        "tare_N": state.tare,
        "k_says": "" if state.live is None else state.live.verdict.headline,
        "clock_sd_s": state.clock_sd,
        **{name: getattr(state, name) for name in _AS_THEY_ARE},
    }


def settings_of(wanted: Mapping[str, Any]) -> live.CaptureSettings:
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
    """As `onebend record`. Raises `OnebendError` if nothing could be recorded."""
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
    try:
        found = overview(folder)
    except OnebendError as error:
        return {"rows": [], "remarks": [], "faults": [str(error)]}
    remarks = [remark.as_dict() for remark in found.remarks]
    return {"rows": found.rows, "remarks": remarks, "faults": found.faults}


def lines_in(handle: int) -> Iterator[str]:
    with open(handle, "rb", buffering=0) as stream:
        while line := stream.readline():
            yield line.decode("utf-8", "replace")


def main() -> int:
    """0: recorded; 2: nothing recorded, or ended by a cable or the disk."""
    lines, talk = lines_in(os.dup(0)), Talk(os.fdopen(os.dup(1), "w"), capture_line)
    nothing = os.open(os.devnull, os.O_RDWR)
    for handle in (0, 1):  # child processes must not hold the studio's pipes
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
