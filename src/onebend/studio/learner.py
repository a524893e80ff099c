"""The process that learns: `python -m onebend.studio.learner`, one JSON object of what to do on standard input.

It does what `onebend learn` does, and says how far it is as lines of JSON on standard output. Interrupted, it keeps the
tags that it found, and leaves earlier results as they are. It goes on when the studio is gone: its result is published
whole, by the same steps.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import onebend
from onebend.errors import OnebendError
from onebend.files.publish import OutputFolder, abandon, finish, prepare, publish
from onebend.learning.inference.stages import FitSettings
from onebend.learning.paper.selection import RegressionSettings
from onebend.pipeline import Run, learn
from onebend.recording.observe import ObserveSettings
from onebend.report.figures.pictures import Pictures
from onebend.results.detection_cache import detection_cache
from onebend.results.learned_files import learned_writer
from onebend.results.provenance import inputs_of, provenance
from onebend.results.recording_files import recording_files
from onebend.results.summary import LEARN_FORMAT, summary_of

_OFTEN = 0.1  # s between two lines of one stage


class Lines:
    """A `Progress` that writes lines of JSON."""

    def __init__(self) -> None:
        self._stack: list[list[Any]] = []  # stage, done, total
        self._said = 0.0

    def start(self, stage: str, total: int | None) -> None:
        self._stack.append([stage, 0, total])
        self._say()

    def advance(self, count: int = 1) -> None:
        self._stack[-1][1] += count
        if time.monotonic() - self._said > _OFTEN:
            self._say()

    def done(self) -> None:
        self._say()
        self._stack.pop()

    def _say(self) -> None:
        self._said = time.monotonic()
        stage, done, total = self._stack[-1]
        tell({"stage": stage, "done": done, "total": total})


def tell(data: Mapping[str, Any]) -> None:
    """One line; nobody may be there any more to read it."""
    with suppress(BrokenPipeError, OSError):
        sys.stdout.write(json.dumps(data) + "\n")
        sys.stdout.flush()


def work(wanted: Mapping[str, Any]) -> None:
    """Learn, and publish.

    Args:
        wanted: "recordings" and "validate", names; "out"; "replace".
    """
    recordings, validate = [Path(one) for one in wanted["recordings"]], [Path(one) for one in wanted["validate"]]
    place = prepare(Path(wanted["out"]), kind=LEARN_FORMAT, overwrite=bool(wanted["replace"]))
    try:
        inputs = inputs_of(recording_files([*recordings, *validate]))
        progress = Lines()
        detect = detection_cache(onebend.__version__, place.work).detect
        run = learn(recordings[0], *recordings[1:], validate_on=validate, detect=detect, progress=progress)
        settings = {"fit": FitSettings(), "regression": RegressionSettings(), "observing": ObserveSettings()}
        made_from = provenance(inputs, dict(wanted), settings)
        _put(place, run, Pictures(), made_from)  # the fit is safe before a picture is drawn
        tell({"published": True})
        from onebend.report.figures.drawing import draw_all  # here: Matplotlib is for pictures alone

        _put(place, run, draw_all(run, progress=progress), made_from)
    except BaseException:
        abandon(place)
        raise
    finish(place)


def _put(place: OutputFolder, run: Run, pictures: Pictures, made_from: dict[str, Any]) -> None:
    version = onebend.__version__
    summary = summary_of(run, written_by=f"onebend {version}")
    write = learned_writer(run, pictures, summary, version=version, made_from=made_from)
    publish(place, write, {**made_from, "pictures_failed": pictures.failed})


def main() -> int:
    """0: done; 2: the recording cannot be learned from; 130: interrupted."""
    wanted = json.loads(sys.stdin.readline())
    os.chdir(wanted["folder"])
    sys.argv = shlex.split(wanted["command"])  # what the result says that it comes from
    try:
        work(wanted)
    except OnebendError as error:
        tell({"error": str(error)})
        return 2
    except KeyboardInterrupt:
        tell({"error": "Stopped."})
        return 130
    tell({"finished": True})
    return 0


if __name__ == "__main__":
    sys.exit(main())
