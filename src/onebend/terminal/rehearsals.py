"""What `onebend rehearse` says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from onebend.beam.profiles.uncertain import half_width_words
from onebend.forecast.prediction import BudgetEntry
from onebend.forecast.rehearsal import MEDIAN, NINETY, Obtained, Rehearsal, setup_words
from onebend.learning.design.proposals import PLACES, identified_words
from onebend.report.wording import significant

EVERY = 10  # of the 101 places
FEW = 12  # runs: with fewer, nine in ten mean little


def show_rehearsal(console: Console, rehearsal: Rehearsal) -> None:
    """All that `onebend rehearse` says."""
    p, o = rehearsal.predicted, rehearsal.obtained
    console.print(f"[bold]{escape(setup_words(rehearsal.setup))}[/]", highlight=False)
    console.print(
        f"k(s) would be known to {p.quality.mean_words} (95 %) on average over the whole beam, to "
        f"{p.quality.worst_words} "
        f"at worst (s = {p.quality.worst_s:.2f}); {identified_words(p.quality)}.\n",
        highlight=False,
    )
    console.print(errors_table(rehearsal))
    if o is not None:
        console.print(f"\n{obtained_words(o)}", highlight=False)
    elif rehearsal.runs:
        console.print(f"\n[yellow]![/] Every fit failed: {escape(rehearsal.runs[0].failure)}", highlight=False)
    console.print()
    console.print(budget_table(rehearsal.budget))
    console.print()
    if rehearsal.advice:
        console.print(advice_table(rehearsal))
    else:
        console.print("No change helps much.")


def errors_table(rehearsal: Rehearsal) -> Table:
    """The error of k along the beam, in percent."""
    p, o = rehearsal.predicted, rehearsal.obtained
    title = "Error of k [%]: median, and nine in ten are below"
    title += "" if np.all(p.identified) else " (*: not identified)"
    table = Table(title=title, title_justify="left", box=None)
    table.add_column("s", justify="right")
    table.add_column("k \\[N m]", justify="right")
    names = ["predicted", "9 in 10"]
    names += [] if o is None else ["obtained", "9 in 10", "in the band"]
    for name in names:
        table.add_column(name, justify="right")
    for i in range(0, len(PLACES), EVERY):
        cells = [_percent(MEDIAN * p.error[i]), _percent(NINETY * p.error[i])]
        if o is not None:
            cells += [_percent(o.median[i]), _percent(o.ninety[i]), f"{100.0 * o.coverage[i]:.0f} %"]
        place = f"{PLACES[i]:.1f}{' ' if p.identified[i] else '*'}"
        table.add_row(place, significant(float(p.k[i])), *cells)
    return table


def budget_table(budget: Sequence[BudgetEntry]) -> Table:
    """The band if one nuisance were known exactly."""
    table = Table(
        title="What costs most: how well k(s) would be known if one thing were known exactly",
        title_justify="left",
        box=None,
    )
    for name in ("known exactly", "k(s) then", "removes"):
        table.add_column(name, justify="left" if name == "known exactly" else "right")
    for entry in budget:
        table.add_row(escape(entry.name), half_width_words(0.5 * entry.mean_width), share_words(entry.share))
    return table


def advice_table(rehearsal: Rehearsal) -> Table:
    """Changes, best first."""
    table = Table(title="What to change, by how much it narrows the band", title_justify="left", box=None)
    for name in ("", "change", "k(s) then", "removes"):
        table.add_column(name, justify="left" if name == "change" else "right")
    for i, change in enumerate(rehearsal.advice, 1):
        table.add_row(str(i), escape(change.text), change.quality.mean_words, share_words(change.share))
    return table


def obtained_words(o: Obtained) -> str:
    """The simulated recordings in a few sentences."""
    came = f"{o.runs} simulated recordings" if o.runs > 1 else "One simulated recording"
    text = f"{came}: the 95 % band held the truth at {100.0 * o.covered:.0f} %"
    text += f" (± {100.0 * o.covered_error:.0f})" if o.covered_error > 0.0 else ""
    text += " of the places that the fits call identified." if np.isfinite(o.covered) else " of no place."
    if not np.isfinite(o.covered):
        text = f"{came}: none calls k identified anywhere."
    if o.runs < FEW:
        text += " So few runs say little about the largest errors."
    if o.failed:
        text += f" {o.failed} more failed: {escape(o.why_failed[0])}"
    return text


def share_words(share: float) -> str:
    """A share of the band."""
    return f"{100.0 * share:.0f} %" if share >= 0.005 else "-"


def _percent(log_error: float) -> str:
    """A size of log k as one of k."""
    return f"{100.0 * np.expm1(log_error):.2g}" if log_error < 1.0 else f"x {np.exp(log_error):.2g}"
