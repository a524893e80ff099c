"""Commands for films of a swing, and for the force on a beam."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import onebend
from onebend.cli import BY, common
from onebend.cli.models import SetUpOptions, read_trusted
from onebend.cli.screens import show_damping, show_frequencies, show_sensed
from onebend.files.publish import amend
from onebend.files.single_file import check_name_free, write_file
from onebend.learning.sensing.sense import SenseSettings, sense as sense_force
from onebend.learning.swing import DampingSettings, FilmPart, frequencies_of, learn_damping
from onebend.options import Only
from onebend.progress import Progress
from onebend.recording.folder import check_same_length, read_recording
from onebend.recording.observe import ObserveSettings, observe, swing_signals
from onebend.records import Observations
from onebend.report.pictures import draw
from onebend.results.detection_cache import detection_cache
from onebend.results.learned_files import damp_summary, frequencies_summary
from onebend.results.model import StoredModel, model_file, model_text
from onebend.results.provenance import inputs_of, recording_files
from onebend.results.sensing import SENSE_FORMAT, sense_summary, write_forces

ModelFile = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the model with its damping here.")
]


Swinging = Annotated[
    Path,
    typer.Argument(
        metavar="REC",
        help="A recording (film or tracks) with a free swing, or a CSV with time_s and a column for each signal.",
    ),
]
Observing = Annotated[ObserveSettings, Only(("threads",))]
FASTEST = 1e5  # largest factor of slow motion
Slowed = Annotated[
    float,
    typer.Option(
        "--slowed",
        min=common.LEAST,
        max=FASTEST,
        metavar="TIMES",
        help="Slow motion: the film plays this many times slower than the swing was.",
    ),
]
MostModes = Annotated[int, typer.Option("--modes", min=1, max=8, metavar="N", help="The largest number of modes.")]


def frequencies(
    source: Swinging,
    *,
    part: FilmPart,
    slowed: Slowed = 1.0,
    most: MostModes = 4,
    observing: Observing,
    as_json: common.Json = False,
    quiet: common.Quiet = False,
) -> None:
    with common.clean_errors(), common.progress_of(quiet) as progress:
        detect = detection_cache(onebend.__version__).detect
        signals = swing_signals(source, threads=observing.threads, detect=detect, progress=progress)
        found = frequencies_of(signals.time, signals.value, part, most=most, name=signals.name)
    found = found.sped_up(slowed)
    common.answer(
        as_json,
        frequencies_summary(str(source), found, written_by=BY),
        lambda console: show_frequencies(console, found),
    )


def damp(
    model: common.Model,
    recording: common.Recording,
    *,
    part: FilmPart,
    settings: DampingSettings,
    output: ModelFile = None,
    observing: Observing,
    overwrite: common.Overwrite = False,
    as_json: common.Json = False,
    quiet: common.Quiet = False,
) -> None:
    with common.clean_errors():
        stored = read_trusted(model)
        if output is not None:
            check_name_free(output, overwrite=overwrite)
        with common.progress_of(quiet) as progress:
            seen = _observed(stored, recording, observing, progress)
            fit = learn_damping(stored.beam, seen, uncertain=stored.uncertain, part=part, settings=settings)
        if output is not None:
            whole = replace(stored, beam=fit.beam, damping=fit.damping)
            text = model_text(whole, written_by=BY)
            if not (overwrite and amend(output, text.encode())):  # a file of a results folder: its summary is renewed
                write_file(output, text, overwrite=overwrite)
    said = {**damp_summary(str(model), fit, written_by=BY), "output": None if output is None else str(output)}
    common.answer(as_json, said, lambda console: show_damping(console, fit, output))


def sense(
    model: common.Model,
    recording: common.Recording,
    *,
    settings: SenseSettings,
    where: SetUpOptions,
    output: common.Output = None,
    observing: Observing,
    overwrite: common.Overwrite = False,
    as_json: common.Json = False,
    quiet: common.Quiet = False,
) -> None:
    with common.clean_errors():
        stored = read_trusted(model)
        with common.place_for(output, SENSE_FORMAT, overwrite) as work:
            with common.progress_of(quiet) as progress:
                seen = _observed(stored, recording, observing, progress)
            setup = where.of(stored)
            found = sense_force(stored.beam, seen, stiffness=stored.uncertain, setup=setup, settings=settings)
            summary = sense_summary(str(model), found, written_by=BY)
            if work is not None:
                from onebend.report.control_figures import sensing  # here: loads Matplotlib

                pictures = draw({"force": lambda: sensing(found)})
                inputs = inputs_of([model_file(model), *recording_files([recording])])
                common.put_results(work, summary, partial(write_forces, found=found), pictures, inputs=inputs)
    common.answer(as_json, summary, lambda console: show_sensed(console, found, output), output)


def _observed(stored: StoredModel, recording: Path, observing: ObserveSettings, progress: Progress) -> Observations:
    files = read_recording(recording)
    check_same_length(stored.beam.length, files)
    detect = detection_cache(onebend.__version__).detect
    return observe(files, settings=observing, detect=detect, progress=progress)
