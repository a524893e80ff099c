"""What each command says in the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from onebend.learning.outcome import Comparison
from onebend.learning.posterior import Posterior
from onebend.learning.verdict import fitted_rms
from onebend.records import Observations
from onebend.report.allowance_words import mounting_words
from onebend.report.confidence import load_error_words, scale_words, stop_words, tradeoff_words, unidentified_words
from onebend.report.findings import Findings, all_remarks, pair_remarks
from onebend.report.kinds import only_frequencies
from onebend.report.modulus import MeasuredBeam, measured_beam, modulus_rows, modulus_words
from onebend.report.verdict import hopeless, verdict_of
from onebend.report.wording import millimetres, significant
from onebend.results.model import StoredModel
from onebend.terminal.damping import damping_words
from onebend.terminal.parts import remarks_list, warnings_list
from onebend.terminal.plots import band_plot, stiffness_plot
from onebend.terminal.tables import (
    allowance_table,
    band_places,
    band_table,
    comparison_table,
    estimate_table,
    nuisance_table,
    selection_table,
    stages_table,
)

_COLOURS = {"holds": "green", "holds with allowances": "green", "not to be trusted": "red", "no band": "yellow"}
_FEWEST_ROWS, _MOST_ROWS = 6, 16  # of the plot of k(s)


def show_run(
    console: Console, run: Findings, out: Path, *, verbose: bool = False, log: bool = False, report: bool = True
) -> None:
    """The answer of `onebend learn`: the verdict, k(s), what is wrong, where the report is; `verbose`: all of it.

    Without a `report` it says where the results are.
    """
    if verbose:
        for part in _everything(run):
            console.print(part)
            console.print()
    console.print(verdict_rows(run))
    console.print()
    for part in [] if hopeless(run) else _stiffness(console, run, log=log):
        console.print(part)
    console.print()
    remarks = all_remarks(run)
    warnings = [pair for pair in remarks if pair[1].level == "warning"]
    if warnings and not verbose:
        console.print(warnings_list(warnings))
    if (notes := len(remarks) - len(warnings)) and not verbose:
        what = "1 note is" if notes == 1 else f"{notes} notes are"
        where = "in the report, or here" if report else "shown"
        console.print(f"[dim]{what} {where} with --verbose[/]")
    say_path(console, "report" if report else "results", out / "report.html" if report else out)


def verdict_rows(run: Findings) -> Table:
    """The verdict, a row each."""
    verdict = verdict_of(run)
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="dim")
    table.add_column(overflow="fold")
    table.add_row("verdict", Text(verdict.headline, f"bold {_COLOURS[verdict.grade]}"))
    for label, words in verdict.rows:
        table.add_row(label, Text(words))
    return table


def _stiffness(console: Console, run: Findings, *, log: bool) -> list[RenderableType]:
    """The plot as large as the screen lets it be, and the numbers below."""
    columns = min(max((console.width - 19) // 10, 4), 10) * 10 + 1
    rows = min(max(console.height - 18, _FEWEST_ROWS), _MOST_ROWS)
    measured = measured_beam(run)
    words = modulus_words(measured)
    below: list[RenderableType] = [_sentences(words)] if words else []
    if run.posterior is None:
        return [stiffness_plot(run.beam, rows=rows), *below]
    uncertain = run.posterior.stiffness
    numbers = band_table(uncertain, columns=columns, modulus=modulus_rows(measured, band_places(columns)))
    return [band_plot(uncertain, columns=columns, rows=rows, log=log), numbers, *below]


def _everything(run: Findings) -> list[RenderableType]:
    """What the answer does not need: it stands in the report as well."""
    parts: list[RenderableType] = []
    if run.learned is not None:
        parts.append(selection_table(run.learned))
    if run.posterior is not None:
        parts += _fit(run, run.posterior)
    seen = not only_frequencies(run.recordings)
    if seen:
        parts.append(comparison_table(run.trainings, "Learned from, force as logged"))
    if seen and run.posterior is not None:
        parts.append(_sentences(_as_logged_words(run, run.posterior)))
    if run.validations:
        parts.append(comparison_table(run.validations, "Validation"))
    return [*parts, remarks_list(all_remarks(run))]


def _as_logged_words(run: Findings, posterior: Posterior) -> list[str]:
    """Why there are two errors of what was learned from."""
    words = []
    for comparison, rms in zip(run.trainings, fitted_rms(posterior), strict=True):
        largest = millimetres(float(np.nanmax(rms)))
        text = f"{comparison.name}: the fit itself is within {largest} mm RMS of every tag."
        if not comparison.static:
            text += " The table is larger by the slow error of the force log, which the fit takes off."
        words.append(text)
    return words


def _fit(run: Findings, posterior: Posterior) -> list[RenderableType]:
    """The estimate beside the paper's, where it is blind, and what else was fitted."""
    uncertain = posterior.stiffness
    blind = unidentified_words(uncertain, len(run.recordings))
    found: list[RenderableType] = [
        estimate_table(uncertain, run.learned, modulus_rows(measured_beam(run), np.linspace(0.0, 1.0, 11)))
    ]
    force = [scale_words(posterior.gain_sd, run.recordings), *load_error_words(posterior.load_error)]
    if len(run.recordings) > 1:
        force.append(mounting_words(posterior))
    found.append(_sentences([*blind, *force, f"The fit {stop_words(posterior)}."]))
    if posterior.attributions:
        found.append(allowance_table(posterior))
    found.append(nuisance_table(posterior.nuisances()))
    words = tradeoff_words(posterior)
    return (
        [*found, _sentences(["Hardly told apart (mean log k(s): over the identified places):", *words])]
        if words
        else found
    )


def show_times(console: Console, run: Findings, seconds: Mapping[str, float]) -> None:
    """The time that each stage took."""
    console.print()
    console.print(stages_table(seconds, run.video_seconds))


def _sentences(words: Sequence[str]) -> Text:
    return Text("\n".join(words))


def say_path(console: Console, what: str, path: Path) -> None:
    """Where something is, on one line whatever the width, so that it can be copied."""
    console.print(f"[bold]{what}[/] {escape(str(path))}", soft_wrap=True, highlight=False)


def show_validation(console: Console, pairs: Sequence[tuple[Comparison, Observations]], out: Path | None) -> None:
    """All that `onebend validate` says."""
    console.print(comparison_table([comparison for comparison, _ in pairs], "Validation"))
    console.print()
    console.print(
        remarks_list(
            [
                (comparison.name, remark)
                for comparison, recording in pairs
                for remark in pair_remarks(comparison, recording)
            ]
        )
    )
    if out is not None:
        say_path(console, "\ntables and figures", out)


def show_model(console: Console, stored: StoredModel, *, log: bool = False) -> None:
    """What `onebend show` draws."""
    beam, origin, uncertain = stored.beam, stored.origin, stored.uncertain
    measured = MeasuredBeam(beam, uncertain, stored.section)
    if uncertain is None:
        console.print(stiffness_plot(beam))
    else:
        console.print(band_plot(uncertain, log=log))
        console.print(band_table(uncertain, columns=61, modulus=modulus_rows(measured, band_places(61))))
        for text in unidentified_words(uncertain):
            console.print(text, markup=False, highlight=False)
    for text in modulus_words(measured):
        console.print(text, markup=False, highlight=False)
    lowest = float(beam.stiffness(np.linspace(0.0, 1.0, 401)).min())
    if lowest <= 0.0:
        console.print(f"[yellow]k(s) falls to {significant(lowest)} N m: this is no beam and cannot be simulated.[/]")
    console.print(f"\nlength {1000 * beam.length:.4g} mm", highlight=False)
    if stored.damping is not None:
        console.print(damping_words(stored.damping), markup=False, highlight=False)
    if origin is not None:
        modes = "" if origin.n is None else f"n = {origin.n}, "
        text = f"learned from {origin.recording} by {origin.method}: {modes}m = {origin.m} {origin.family}"
        console.print(text, markup=False, highlight=False)
