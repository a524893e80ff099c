"""Commands over many recordings."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from onebend.cli import common
from onebend.files.publish import workplace
from onebend.many import batch as batches, population_report
from onebend.many.batch import BatchOutcome, run_batch
from onebend.many.population import TABLES, read_batch
from onebend.report.sentences import significant
from onebend.results.provenance import inputs_of
from onebend.text_files import one_line

MOST_ROWS = 20  # rows shown of each kind


def show_batch(console: Console, outcome: BatchOutcome) -> None:
    there = len(outcome.items) - outcome.learned_now
    before = f", {there} of them before" if there else ""
    console.print(_answer_table(outcome))
    if (more := len(outcome.items) - MOST_ROWS) > 0:
        console.print(f"and {more} more: index.html and recordings.parquet have all.", markup=False)
    console.print(
        f"{len(outcome.learned)} of {len(outcome.items)} recordings learned{before}; {len(outcome.in_doubt)} in doubt.",
        markup=False,
    )
    _show_reasons(console, "recording", "in doubt", outcome.in_doubt)
    _show_reasons(console, "recording", "not learned", [(item.name, why) for item, why in outcome.failed])
    console.print(
        f"Wrote {outcome.out}: index.html, recordings.parquet, curves.parquet, covariances.parquet, nuisances.parquet",
        markup=False,
    )


def _answer_table(outcome: BatchOutcome) -> Table:
    table = common.listing("k(s) of each recording", "<recording", "k(0.5) [N m]", "95 % from", "to", "known")
    table.add_column("verdict", overflow="fold")
    table.add_column("warnings", justify="right")
    for one in batches.answers(outcome)[:MOST_ROWS]:
        band = map(significant, (one.low, one.high))
        cells = (one.k_words, *band, one.identified_words, one.verdict, str(one.warnings or ""))
        table.add_row(Text(one_line(one.name)), *map(Text, cells))
    return table


def _show_reasons(console: Console, head: str, title: str, rows: Sequence[tuple[str, str]]) -> None:
    """The first rows of names and reasons."""
    if rows:
        table = Table(head, "why", title=f"{title}: {len(rows)}", title_justify="left")
        for name, why in rows[:MOST_ROWS]:
            table.add_row(Text(one_line(name)), Text(" ".join(why.split())))
        console.print(table)


def show_population(console: Console, outcome: population_report.PopulationOutcome, output: Path) -> None:
    named = outcome.named
    middle = len(named.trial.s) // 2
    heads = ("objects", "k(0.5) [N m]", "95 % from", "to", "half-width")
    table = common.listing("mean k(s)", "<group", *heads)
    curves = (outcome.means.mean, outcome.means.low, outcome.means.high)
    for i, row in enumerate(population_report.group_rows(outcome)):
        values = [significant(float(np.exp(one[i, middle]))) for one in curves]
        half = population_report.percent(row["half_band"])
        table.add_row(population_report.group_name(row["group"]), str(row["objects"]), *values, half)
    console.print(table)
    for what, numbers in population_report.spread_rows(outcome):
        value, low, high = map(population_report.percent, numbers)
        if np.isfinite(numbers[0]):
            console.print(f"{what}: {value} (95 %: {low} to {high})", markup=False)
    rows = [(name, why) for name, why in zip(named.objects, outcome.outliers, strict=True) if why]
    _show_reasons(console, "name", "unlike the others", rows)
    _show_reasons(console, "name", "left out", named.left_out)
    console.print(f"Wrote {output / 'report.html'}", markup=False)


def batch(
    source: Path,
    *,
    output: Path,
    workers: int | None = None,
    scheduler: str | None = None,
    folders: bool = False,
    told: common.Told,
) -> None:
    with common.progress_of(told) as progress:
        outcome = run_batch(source, output, workers=workers, scheduler=scheduler, folders=folders, progress=progress)
    summary = batches.summary_of(outcome)
    batches.write_batch(outcome, summary)
    common.answer(told, summary, lambda console: show_batch(console, outcome), output)


def population(
    results: Path,
    *,
    output: Path,
    setting: population_report.PopulationSettings,
    told: common.OwnOutput,
) -> None:
    with (
        workplace(output, population_report.POPULATION_FORMAT, told.overwrite) as place,
        common.progress_of(told) as progress,
    ):
        inputs = inputs_of([results / f"{name}.parquet" for name in TABLES])
        found = population_report.population(read_batch(results, setting.by, setting.same), setting)
        pictures = population_report.draw_figures(found, progress=progress)
        summary = population_report.summary_of(found)
        name = results.resolve().name
        tables = partial(population_report.write_report, outcome=found, figures=pictures.drawn, name=name)
        common.put_results(place, summary, tables, pictures, figures=None, inputs=inputs)
    common.answer(told, summary, lambda console: show_population(console, found, output), output)
