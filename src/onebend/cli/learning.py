"""Commands that learn, validate and plan; and those for swings and for the force on a beam."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from onebend.cli import common
from onebend.cli.models import SetUpOptions, read_trusted
from onebend.cli.screens import show_damping, show_frequencies, show_run, show_sensed, show_validation
from onebend.files.publish import amend, this_onebend, workplace
from onebend.files.single_file import check_name_free, write_file
from onebend.learning import design, optimizer, paper, swing
from onebend.learning.sensing.sense import SenseSettings, sense as sense_force
from onebend.options import Only
from onebend.pipeline import Run, compare, learn as learn_from, plan_next
from onebend.progress import Progress
from onebend.recording.folder import check_same_length, folder_of, read_recording
from onebend.recording.observe import ObserveSettings, observe, swing_signals
from onebend.recording.video import KeptFrames
from onebend.records import Observations
from onebend.report.pictures import Pictures, draw
from onebend.report.sentences import direction_words, say, significant, width_words, words
from onebend.results import learned_files
from onebend.results.detection_cache import detection_cache
from onebend.results.learned_files import damp_summary, frequencies_summary
from onebend.results.model import StoredModel, model_file, model_text
from onebend.results.observations_file import observations_beside
from onebend.results.provenance import inputs_of, recording_files
from onebend.results.sensing import SENSE_FORMAT, sense_summary, write_forces

Watched = Annotated[ObserveSettings, Only(("threads",))]


def frequencies(
    source: Path,
    *,
    part: swing.FilmPart,
    slowed: float = 1.0,
    most: int = 4,
    observing: Watched,
    told: common.Told,
) -> None:
    with common.progress_of(told) as progress:
        detect = detection_cache().detect
        signals = swing_signals(source, threads=observing.threads, detect=detect, progress=progress)
        found = swing.frequencies_of(signals.time, signals.value, part, most=most, name=signals.name)
    found = found.sped_up(slowed)
    common.answer(told, frequencies_summary(str(source), found), lambda console: show_frequencies(console, found))


def damp(
    model: Path,
    recording: Path,
    *,
    part: swing.FilmPart,
    settings: swing.DampingSettings,
    output: Path | None = None,
    observing: Watched,
    told: common.OwnOutput,
) -> None:
    stored = read_trusted(model)
    if output is not None:
        check_name_free(output, overwrite=told.overwrite)
    with common.progress_of(told) as progress:
        seen = _observed(stored, recording, observing, progress)
        fit = swing.learn_damping(stored.beam, seen, uncertain=stored.uncertain, part=part, settings=settings)
    if output is not None:
        whole = replace(stored, beam=fit.beam, damping=fit.damping)
        text = model_text(whole, written_by=this_onebend())
        if not (told.overwrite and amend(output, text.encode())):  # a file of a results folder: its summary is renewed
            write_file(output, text, overwrite=told.overwrite)
    said = {**damp_summary(str(model), fit), "output": None if output is None else str(output)}
    common.answer(told, said, lambda console: show_damping(console, fit, output))


def sense(
    model: Path,
    recording: Path,
    *,
    settings: SenseSettings,
    where: SetUpOptions,
    observing: Watched,
    told: common.AnswerOptions,
) -> None:
    stored = read_trusted(model)
    with common.place_for(told, SENSE_FORMAT) as work:
        with common.progress_of(told) as progress:
            seen = _observed(stored, recording, observing, progress)
        setup = where.of(stored)
        found = sense_force(stored.beam, seen, stiffness=stored.uncertain, setup=setup, settings=settings)
        summary = sense_summary(str(model), found)
        if work is not None:
            from onebend.report.control_figures import sensing  # here: loads Matplotlib

            pictures = draw({"force": lambda: sensing(found)})
            inputs = inputs_of([model_file(model), *recording_files([recording])])
            common.put_results(work, summary, partial(write_forces, found=found), pictures, inputs=inputs)
    common.answer(told, summary, lambda console: show_sensed(console, found, told.output))


def _observed(stored: StoredModel, recording: Path, observing: ObserveSettings, progress: Progress) -> Observations:
    files = read_recording(recording)
    check_same_length(stored.beam.length, files)
    detect = detection_cache().detect
    return observe(files, settings=observing, detect=detect, progress=progress)


def plan_table(plan: design.Plan) -> Table:
    title = "Next pushes, those that need nothing new first, then by the mean half-width that k(s) would have"
    table = common.listing(title, "", "push at s", "<force", "to [N]", "tip [mm]", "<needs", "k(s) then")
    for i, proposal in enumerate(plan.proposals):
        needs = "the same once more" if proposal.repeats else "nothing new"
        table.add_row(
            str(i + 1),
            f"{proposal.push.at_s:.2f}",
            direction_words(proposal.push.direction),
            significant(proposal.push.largest),
            f"{1e3 * proposal.tip_moves:.0f}",
            words(proposal.needs) if proposal.needs else needs,
            width_words(proposal.after.mean_width),
        )
    return table


def show_plan(console: Console, plan: design.Plan) -> None:
    console.print(say("known now", **vars(plan)))
    console.print(plan_table(plan))
    console.print("\n[bold]best:[/]", Text(words(plan.proposals[0].notice)))
    pair = "; then ".join(words(proposal.notice) for proposal in plan.pair)
    console.print("[bold]best pair with the present bench:[/]", Text(pair))
    for reason in plan.left_out:
        console.print(f"[yellow]![/] {escape(reason)}")


Observing = Annotated[ObserveSettings, Only(("threads", "epsilon"))]


def learn(
    recordings: list[Path],
    *,
    validate_on: list[Path] | None = None,
    method: Literal["fit", "regression", "paper"] = "fit",
    settings: paper.RegressionSettings,
    fitting: optimizer.FitSettings,
    observing: Observing,
    no_report: bool = False,
    told: common.AnswerOptions,
) -> None:
    out = told.output or Path(f"{folder_of(recordings[0]).resolve().name}-results")
    settings = replace(settings, method="paper" if method == "paper" else "regression")
    fit = fitting if method == "fit" else None
    frames = KeptFrames()
    with workplace(out, learned_files.LEARN_FORMAT, told.overwrite) as place:
        inputs = inputs_of(recording_files([*recordings, *(validate_on or ())]))
        with common.progress_of(told) as progress:
            run = learn_from(
                *recordings,
                settings=settings,
                fitting=fit,
                observing=observing,
                validate_on=validate_on or (),
                detect=detection_cache().detect,
                frames=frames,
                progress=progress,
            )
        summary = learned_files.summary_of(run)
        settled = {"fit": fit, "regression": settings, "observing": observing}
        tables = learned_files.tables_writer(run)

        def put(pictures: Pictures | None) -> None:
            made_from = common.made_from_files(inputs, settled)
            write = learned_files.learned_writer(run, pictures, summary, made_from=made_from, tables=tables)
            common.put_in_place(place, write, pictures.failed if pictures else {}, made_from=made_from)

        put(None if no_report else Pictures())  # the fit is safe before pictures are drawn
        if told.listener is not None:
            told.listener.published()
        elif not told.as_json:
            show_run(common.screen(), run, out, report=not no_report)
        if not no_report:
            with common.progress_of(told) as progress:
                pictures = draw_all(run, frames=frames, progress=progress)
            put(pictures)
    if told.as_json:
        common.print_json({**summary, "output": str(out)})


def draw_all(run: Run, *, frames: KeptFrames, progress: Progress) -> Pictures:
    """Every figure of a report."""
    from onebend.report import figures as drawing  # here: Matplotlib loads slowly

    return drawing.draw_all(run, frames=frames, progress=progress)


def validate(
    model: Path,
    recordings: list[Path],
    *,
    where: SetUpOptions,
    observing: Observing,
    told: common.AnswerOptions,
) -> None:
    stored = read_trusted(model)
    setup, known = where.of(stored), observations_beside(model)
    with (
        common.place_for(told, learned_files.VALIDATE_FORMAT) as place,
        common.progress_of(told) as progress,
    ):
        inputs = () if place is None else inputs_of([model_file(model), *recording_files(recordings)])
        pairs = compare(
            stored.beam,
            recordings,
            learned_from=known,
            stiffness=stored.uncertain,
            setup=setup,
            observing=observing,
            detect=detection_cache().detect,
            progress=progress,
        )
        summary = learned_files.validation_summary(str(model), pairs)
        if place is not None:
            from onebend.report.figures import validation_figures  # here, as above

            pictures = draw(validation_figures(stored.beam, pairs), progress)
            tables = partial(learned_files.write_comparisons, comparisons=[comparison for comparison, _ in pairs])
            common.put_results(place, summary, tables, pictures, figures="figures", inputs=inputs)
    common.answer(told, summary, lambda console: show_validation(console, pairs, told.output))


def plan(model: Path, *, settings: design.PlanSettings, told: common.Told) -> None:
    with common.progress_of(told) as progress:
        read_trusted(model)  # warns of doubts
        found = plan_next(model, settings=settings, progress=progress)
    summary = learned_files.plan_summary(str(model), found)
    common.answer(told, summary, lambda console: show_plan(console, found))
