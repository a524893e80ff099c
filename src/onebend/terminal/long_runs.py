"""What `onebend reproduce`, `onebend batch` and `onebend population` say in the end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from onebend.batch.outcome import BatchOutcome
from onebend.escaping import one_line
from onebend.population.outcome import PopulationOutcome
from onebend.population.page import SPREAD, count_words, group_name, judged_words, percent
from onebend.report.wording import UNKNOWN, millimetres, significant
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


def show_population(console: Console, outcome: PopulationOutcome, output: Path) -> None:
    """The groups' means, the spread, what is unlike the others, and where the report is."""
    named = outcome.named
    middle = len(named.trial.s) // 2
    table = Table(title="mean k(s)", title_justify="left", box=None, pad_edge=False)
    table.add_column("group")
    for head in ("objects", "k(0.5) \\[N m]", "95 % from", "to", "half band", "for the wished band"):
        table.add_column(head, justify="right")
    for i, name in enumerate(named.groups):
        curves = (outcome.means.mean, outcome.means.low, outcome.means.high)
        values = [significant(float(np.exp(one[i, middle]))) for one in curves]
        count = str(int(np.sum(named.trial.group_of == i)))
        half = percent(float(np.expm1(outcome.half[i])))
        table.add_row(group_name(name), count, *values, half, count_words(outcome.needed[i]))
    console.print(table)
    for key, one in vars(outcome.shares).items():
        what, of_log_k = SPREAD[key]
        numbers = [np.expm1(value) if of_log_k else value for value in (one.value, one.low, one.high)]
        if np.isfinite(numbers[0]):
            text = f"{what}: {percent(numbers[0])} (95 %: {percent(numbers[1])} to {percent(numbers[2])})"
            console.print(text, markup=False)
    rows = [(name, why) for name, why in zip(named.objects, outcome.outliers, strict=True) if why]
    for title, shown in (("unlike the others", rows), ("left out", named.left_out)):
        if shown:
            listed = Table("name", "why", title=f"{title}: {len(shown)}", title_justify="left")
            for name, why in shown[:MOST]:
                listed.add_row(one_line(name), one_line(why))
            console.print(listed)
    if words := judged_words(outcome):
        console.print(words, markup=False)
    console.print(f"Wrote {output / 'report.html'}", markup=False)
