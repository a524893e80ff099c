"""The tables of the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.markup import escape
from rich.table import Table

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.learning.outcome import Comparison, Learned
from onebend.learning.posterior import Nuisance, Posterior
from onebend.report.confidence import allowance_rows, nuisance_rows
from onebend.report.wording import bic_words, millimetres, percent, significant, stage_rows


def selection_table(learned: Learned) -> Table:
    """The (n, m) table of the paper; the chosen row marked, rows out of the running dimmed with the reason."""
    title = f"{escape(learned.training.name)}: the paper's regression, RMS per marker and BIC"
    table = Table(title=title, title_justify="left", box=None)
    table.add_column("")
    for name in ("n", "m", *_marker_names(learned.training), "BIC"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for i, trial in enumerate(learned.trials):
        chosen = i == learned.chosen
        cells = [str(trial.n), str(trial.m), *map(millimetres, trial.rms), bic_words(trial.bic)]
        style = "bold green" if chosen else "dim" if trial.why_out else ""
        table.add_row("➤" if chosen else "", *cells, escape("chosen" if chosen else trial.why_out), style=style)
    return table


def _marker_names(comparison: Comparison) -> list[str]:
    return [f"M{i + 1} \\[mm]" for i in range(len(comparison.tag_id))]


def comparison_table(comparisons: Sequence[Comparison], what: str) -> Table:
    """Tables IV to VI: RMS per marker, and in brackets what the force's noise alone explains."""
    widest = max(comparisons, key=lambda comparison: len(comparison.tag_id))
    table = Table(title=f"{what}: RMS per marker (explained by the force's noise)", title_justify="left", box=None)
    table.add_column("recording", overflow="fold")
    table.add_column("frames", justify="right")
    for name in _marker_names(widest):
        table.add_column(name, justify="right", no_wrap=True)
    for comparison in comparisons:
        pairs = zip(comparison.rms, comparison.sensor_rms, strict=True)
        cells = [f"{millimetres(rms)} [dim]({millimetres(sensor)})[/]" for rms, sensor in pairs]
        table.add_row(escape(comparison.name), str(len(comparison.frame)), *cells)
    return table


def estimate_table(uncertain: UncertainStiffness, regression: Learned | None) -> Table:
    """k at eleven places with its band, the paper's beside it."""
    s = np.linspace(0.0, 1.0, 11)
    band = uncertain.band(s)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for name in ("s", "k [N m]", "95 % band", "", "identified"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    if regression is not None:
        table.add_column("the paper's k", justify="right", no_wrap=True)
    columns = zip(s, band.k, band.low, band.high, band.identified, strict=True)
    for i, (place, k, low, high, known) in enumerate(columns):
        cells = [f"{place:.1f}", significant(k), significant(low), significant(high), "yes" if known else "no"]
        if regression is not None:
            cells.append(f"[dim]{significant(float(regression.beam.stiffness(s[i])))}[/]")
        table.add_row(*cells, style="" if known else "bright_black")
    return table


def nuisance_table(nuisances: Sequence[Nuisance]) -> Table:
    """What else was fitted, before and after the data; what lies more than 2 sd off in colour."""
    table = Table(title="Fitted with k(s)", title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("", overflow="fold")
    for name in ("value", "sd before", "sd after", ""):
        table.add_column(name, justify="right" if name else "left", no_wrap=True)
    for row in nuisance_rows(nuisances):
        style = "yellow" if row.moved > 2.0 else ""
        table.add_row(escape(row.name), row.value, row.before, row.after, row.unit, style=style)
    return table


def allowance_table(posterior: Posterior) -> Table:
    """What the fit allows for, and what each costs; what matters stands out."""
    table = Table(title="Allowed for", title_justify="left", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("", overflow="fold")
    for name in ("widens the band by", "k(s) without it", "sd from nothing"):
        table.add_column(name, justify="right")
    for row in allowance_rows(posterior):
        table.add_row(row.name, row.widening, row.change, row.sds, style="bold" if row.matters else "")
    return table


def stages_table(seconds: Mapping[str, float], video_seconds: float) -> Table:
    """Time of every stage, and its share of the video's length."""
    table = Table(title=f"Time (the video plays {video_seconds:.1f} s)", title_justify="left", box=None)
    table.add_column("stage")
    table.add_column("s", justify="right")
    table.add_column("of the video", justify="right")
    *stages, total = stage_rows(seconds)
    for name, value in stages:
        table.add_row(escape(name), f"{value:.2f}", percent(value, video_seconds))
    table.add_row(total[0], f"{total[1]:.2f}", percent(total[1], video_seconds), style="bold")
    return table
