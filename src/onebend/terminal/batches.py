"""What a batch found, on the screen."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from onebend.batch.outcome import BatchOutcome
from onebend.escaping import one_line

MOST = 20  # rows of each kind


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
        f"Wrote {outcome.out}: index.html, recordings.parquet, curves.parquet, nuisances.parquet", markup=False
    )
