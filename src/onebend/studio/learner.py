"""The learning process, `python -m onebend.studio.learner`, with one JSON object on standard input.

It does what `onebend learn` does, with progress as JSON lines. Interrupted, it keeps earlier results. It
outlives the studio.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from onebend.files.publish import OutputFolder, abandon, finish, prepare, publish
from onebend.learning.optimizer import FitSettings
from onebend.learning.paper import RegressionSettings
from onebend.pipeline import Run, learn
from onebend.recording.observe import ObserveSettings
from onebend.report.pictures import Pictures
from onebend.results.detection_cache import detection_cache
from onebend.results.learned_files import LEARN_FORMAT, learned_writer, summary_of
from onebend.results.provenance import inputs_of, provenance, recording_files
from onebend.studio.jobs import Lines, process, tell


def work(wanted: Mapping[str, Any]) -> None:
    """`wanted`: "recordings" and "validate" (names), "out", "replace"."""
    recordings, validate = [Path(one) for one in wanted["recordings"]], [Path(one) for one in wanted["validate"]]
    place = prepare(Path(wanted["out"]), kind=LEARN_FORMAT, overwrite=bool(wanted["replace"]))
    try:
        inputs = inputs_of(recording_files([*recordings, *validate]))
        progress = Lines()
        detect = detection_cache().detect
        run = learn(recordings[0], *recordings[1:], validate_on=validate, detect=detect, progress=progress)
        settings = {"fit": FitSettings(), "regression": RegressionSettings(), "observing": ObserveSettings()}
        made_from = provenance(inputs, wanted, settings)
        _put(place, run, Pictures(), made_from)  # the fit is safe before pictures are drawn
        tell({"published": True})
        from onebend.report.figures import draw_all  # here: loads Matplotlib

        _put(place, run, draw_all(run, progress=progress), made_from)
    except BaseException:
        abandon(place)
        raise
    finish(place)


def _put(place: OutputFolder, run: Run, pictures: Pictures, made_from: dict[str, Any]) -> None:
    write = learned_writer(run, pictures, summary_of(run), made_from=made_from)
    publish(place, write, {**made_from, "pictures_failed": pictures.failed})


if __name__ == "__main__":
    sys.exit(process(work))
