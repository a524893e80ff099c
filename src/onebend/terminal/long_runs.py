"""What `onebend reproduce` and `onebend batch` say in the end."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from onebend.batch.outcome import BatchOutcome
from onebend.escaping import one_line
from onebend.report.wording import UNKNOWN, millimetres
from onebend.studies.assumed import quick_words
from onebend.studies.outcome import StudyOutcome
from onebend.studies.printed import printed_m3
from onebend.studies.tables import below_printed

MOST = 20  # rows of each kind that are shown of a batch


def show_reproduced(console: Console, outcome: StudyOutcome, output: Path) -> None:
    """The error at the tip of every validation, the tasks, and where the report is."""
    table = Table(title="RMS error at the tip \\[mm]", title_justify="left", box=None, pad_edge=False)
    for name in ("beam", "push"):
        table.add_column(name)
    for name in ("printed", "paper's method", "fit", "true beam"):
        table.add_column(name, justify="right")
    for beam in outcome.beams:
        for film in beam.films[1:]:
            printed = printed_m3(beam.name, film.strategy.name)
            table.add_row(
                beam.name,
                film.strategy.name,
                UNKNOWN if printed is None else millimetres(printed),
                UNKNOWN if film.paper is None else millimetres(film.paper.rms[-1]),
                f"[bold]{millimetres(film.fit.rms[-1])}[/]",
                millimetres(film.true.rms[-1]),
            )
    console.print(table)
    below, known = below_printed(outcome)
    tasks = [done for beam in outcome.beams for done in beam.tasks if done.way == "fit"]
    reached = sum(done.found.converged for done in tasks)
    console.print(f"\nThe fit is below the printed error in {below} of {known} validations.", highlight=False)
    console.print(f"{reached} of {len(tasks)} manipulation tasks reached their goals.", highlight=False)
    if words := quick_words(outcome.setting):
        console.print(words, highlight=False)
    console.print(f"Wrote {output / 'report.html'}", highlight=False, markup=False)


def show_batch(console: Console, outcome: BatchOutcome) -> None:
    """How many were learned, which were not and why, and which are unlike the others."""
    learned = sum(one.k is not None for one in outcome.records)
    there = len(outcome.items) - outcome.learned_now
    before = f", {there} of them before" if there else ""
    console.print(f"{learned} of {len(outcome.items)} recordings learned{before}.", markup=False)
    doubted = sum(bool(one.doubts) for one in outcome.records)
    if doubted:
        console.print(f"{doubted} are in doubt as a whole: the column doubts says why.", markup=False)
    for title, rows in (("not learned", outcome.failed), ("unlike the others", outcome.outliers)):
        if not rows:
            continue
        table = Table("recording", "why", title=f"{title}: {len(rows)}", title_justify="left")
        for item, why in rows[:MOST]:
            table.add_row(one_line(item.name), one_line(why))
        console.print(table)
    console.print(
        f"Wrote {outcome.out}: index.html, recordings.parquet, curves.parquet, covariances.parquet, nuisances.parquet",
        markup=False,
    )
