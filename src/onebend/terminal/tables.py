"""The tables of the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from onebend.beam.profiles.uncertain import Band, UncertainStiffness, half_width_words
from onebend.learning.outcome import Comparison, Learned
from onebend.learning.posterior import Nuisance, Posterior
from onebend.records import Array
from onebend.report.confidence import allowance_rows, nuisance_rows
from onebend.report.modulus import ModulusRows
from onebend.report.wording import (
    UNKNOWN,
    bic_words,
    millimetres,
    percent,
    significant,
    stage_rows,
    tag_words,
)

FEW = 4  # tags whose columns fit side by side in 80
WIDE = 91  # columns of a plot: eleven numbers fit below it


def selection_table(learned: Learned) -> Table:
    """The (n, m) table of the paper; the chosen row marked, rows out of the running dimmed with the reason."""
    title = f"{escape(learned.training.name)}: the paper's regression, RMS of the tags and BIC"
    table = Table(title=title, title_justify="left", box=None)
    table.add_column("")
    names, errors = _trial_errors(learned)
    for name in ("n", "m", *names, "BIC"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for i, trial in enumerate(learned.trials):
        chosen = i == learned.chosen
        cells = [str(trial.n), str(trial.m), *errors[i], bic_words(trial.bic)]
        style = "bold green" if chosen else "dim" if trial.why_out else ""
        table.add_row("➤" if chosen else "", *cells, escape("chosen" if chosen else trial.why_out), style=style)
    return table


def _trial_errors(learned: Learned) -> tuple[list[str], list[list[str]]]:
    """Headings, and cells of every trial: each tag's RMS, or the worst alone where there are many."""
    if len(learned.training.tag_id) <= FEW:
        return [f"tag {tag}\n\\[mm]" for tag in learned.training.tag_id], [
            list(map(millimetres, t.rms)) for t in learned.trials
        ]
    worst = [float(np.max(np.nan_to_num(t.rms, nan=-1.0))) for t in learned.trials]
    return ["worst tag \\[mm]"], [[millimetres(rms) if rms >= 0.0 else UNKNOWN] for rms in worst]


def comparison_table(comparisons: Sequence[Comparison], what: str) -> Table:
    """Tables IV to VI, one tag a row: RMS, the force noise, and what is likely."""
    meaning = "force noise: from the log's noise alone; likely: with the band of k(s) and the push's place"
    table = Table(title=f"{what}: RMS distance ({meaning})", title_justify="left", box=None)
    table.add_column("recording", overflow="fold", ratio=1)
    table.add_column("frames", justify="right", no_wrap=True)
    table.add_column("tag", no_wrap=True)
    for name in ("s", "RMS \\[mm]", "force noise \\[mm]", "likely \\[mm]"):
        table.add_column(name, justify="right", no_wrap=True)
    for one in comparisons:
        for i, s in enumerate(one.marker_s):
            whose = (escape(one.name), str(len(one.frame))) if i == 0 else ("", "")
            beside = [f"[dim]{millimetres(rms)}[/]" for rms in (one.sensor_rms[i], one.likely_rms[i])]
            table.add_row(*whose, tag_words(one, i), f"{s:.3g}", millimetres(one.rms[i]), *beside)
    return table


def band_places(columns: int) -> Array:
    """Six or eleven places, as many as fit below a plot of so many columns."""
    return np.linspace(0.0, 1.0, 11 if columns >= WIDE else 6)


def band_table(uncertain: UncertainStiffness, *, columns: int, modulus: ModulusRows | None = None) -> Table:
    """k and its band at `band_places`, as they lie below a plot of so many columns; Young's modulus there below it."""
    s = band_places(columns)
    count, band = len(s), uncertain.band(s)
    table = Table(box=None, show_header=False, pad_edge=False, padding=0)
    table.add_column(width=9)
    for i in range(count):
        table.add_column(width=(columns - 1) // (count - 1) if i < count - 1 else None, no_wrap=True)
    styles = ["" if known else "bright_black" for known in band.identified]

    def add(name: str, cells: Sequence[str]) -> None:
        table.add_row(Text(f"{name:>8}", "dim"), *(Text(*pair) for pair in zip(cells, styles, strict=True)))

    add("s", ["0 clamp", *(f"{value:.1f}" for value in s[1:-1]), "1 tip"])
    rows: list[tuple[str, Sequence[str]]] = [
        (name, [significant(float(value)) for value in values])
        for name, values in (("k [N m]", band.k), ("from", band.low), ("to", band.high))
    ]
    rows.insert(1, ("±", half_widths(band)))
    if modulus is not None:
        rows += [(f"E [{modulus.unit}]", modulus.values), ("from", modulus.low), ("to", modulus.high)]
    for name, cells in rows:
        add(name, [cell if known else f"({cell})" for cell, known in zip(cells, band.identified, strict=True)])
    return table


def half_widths(band: Band) -> list[str]:
    """Half the band at each place: "7.4 %", "x 2.4"."""
    halves = 0.5 * np.log(band.high / band.low)
    return [half_width_words(float(half)).removeprefix("± ").replace("a factor of ", "x ") for half in halves]


def estimate_table(
    uncertain: UncertainStiffness, regression: Learned | None, modulus: ModulusRows | None = None
) -> Table:
    """k at eleven places with its band, the paper's beside it; and Young's modulus there."""
    s = np.linspace(0.0, 1.0, 11)
    band = uncertain.band(s)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for name in ("s", "k [N m]", "± 95 %", "from", "to", "identified"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    if regression is not None:
        table.add_column("paper's k", justify="right", no_wrap=True)
    if modulus is not None:
        for name in (f"E [{modulus.unit}]", "from", "to"):
            table.add_column(escape(name), justify="right", no_wrap=True)
    columns = zip(s, band.k, half_widths(band), band.low, band.high, band.identified, strict=True)
    for i, (place, k, half, low, high, known) in enumerate(columns):
        cells = [f"{place:.1f}", significant(k), half, significant(low), significant(high), "yes" if known else "no"]
        if regression is not None:
            cells.append(f"[dim]{significant(float(regression.beam.stiffness(s[i])))}[/]")
        if modulus is not None:
            cells += [modulus.values[i], modulus.low[i], modulus.high[i]]
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
