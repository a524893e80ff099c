"""`python -m benchmarks.paper -o OUT`: repeat the paper's experiments; docs/reproduce.md describes what comes out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmarks.paper import report, study
from onebend.cli import common
from onebend.crash import clean_errors
from onebend.files.publish import this_onebend, write_summary
from onebend.options import expanded
from onebend.report.sentences import UNKNOWN, millimetres

Out = Annotated[Path, typer.Option("--output", "-o", metavar="OUT", help="Folder for films, tables and report.")]
Processes = Annotated[
    int | None, typer.Option("--processes", min=1, metavar="N", help="Number of processes; default: one per core.")
]


def show(console: Console, outcome: study.StudyOutcome, output: Path) -> None:
    heads = ("<beam", "<push", "printed", "paper's method", "fit", "true beam")
    table = common.listing("RMS error at the tip [mm]", *heads)
    for beam in outcome.beams:
        for film in beam.films[1:]:
            printed = study.printed_m3(beam.name, film.strategy.name)
            paper = None if film.paper is None else film.paper.rms[-1]
            before = (UNKNOWN if error is None else millimetres(error) for error in (printed, paper))
            ours = f"[bold]{millimetres(film.fit.rms[-1])}[/]", millimetres(film.true.rms[-1])
            table.add_row(beam.name, film.strategy.name, *before, *ours)
    console.print(table)
    below, known = report.below_printed(outcome)
    tasks = [done for beam in outcome.beams for done in beam.tasks if done.way == "fit"]
    reached = sum(done.found.converged for done in tasks)
    console.print(f"\nThe fit is below the printed error in {below} of {known} validations.")
    console.print(f"{reached} of {len(tasks)} manipulation tasks reached their goals.")
    if words := study.quick_words(outcome.setting):
        console.print(words)
    console.print(f"Wrote {output / 'report.html'}", markup=False)


def reproduce(
    *,
    output: Out,
    setting: study.StudySettings,
    processes: Processes = None,
    told: common.Told,
) -> None:
    """Repeat the paper's experiments: films of three beams, tables, figures and tasks in one report."""
    with clean_errors(), common.progress_of(told) as progress:
        found = study.reproduce(output, setting, written_by=this_onebend(), processes=processes or 0, progress=progress)
        pictures = report.draw_figures(found, progress=progress)
        common.say_failed(pictures.failed)
        pictures.write(output / "figures")
        report.write_report(output, found, pictures.drawn)
        summary = {**report.summary_of(found), **common.made_from_files((), {"study": setting})}
        write_summary(output, summary)
    common.answer(told, summary, lambda console: show(console, found, output), output)


app = typer.Typer(add_completion=False)
app.command()(expanded(reproduce))

if __name__ == "__main__":
    app()
