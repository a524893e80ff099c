"""What each command says in the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.panel import Panel
from rich.text import Text

from onebend.learning.outcome import Comparison
from onebend.learning.posterior import Posterior
from onebend.learning.verdict import fitted_rms, grade_words
from onebend.records import Observations
from onebend.report.confidence import gain_words, load_error_words, stop_words, tradeoff_words, unidentified_words
from onebend.report.findings import Findings, all_remarks, pair_remarks
from onebend.report.page.cards import band_card, stiffness_range
from onebend.report.wording import millimetres, significant, worst_marker
from onebend.results.model import StoredModel
from onebend.terminal.damping import damping_words
from onebend.terminal.parts import remarks_list
from onebend.terminal.plots import band_plot, stiffness_plot
from onebend.terminal.tables import (
    allowance_table,
    comparison_table,
    estimate_table,
    nuisance_table,
    selection_table,
    stages_table,
)


def headline(run: Findings) -> Panel:
    """The result in a few lines."""
    low, high = stiffness_range(run)
    lines = [f"[bold]k(s)[/] from {significant(low)} to {significant(high)} N m"]
    if run.posterior is not None:
        card = band_card(run.posterior.stiffness)
        if run.posterior.doubts:
            lines.append(f"[bold red]{card['value']}[/]: {escape(card['note'])} (see above)")
        else:
            lines[0] += f", known to {card['value']} ({card['note']})"
            lines.append(f"[bold]verdict[/] {escape(grade_words(run.posterior))}")
        lines.append(f"[bold]fit[/] {stop_words(run.posterior)}")
    elif run.learned is not None:
        trial = run.learned.trials[run.learned.chosen]
        how = f"m = {trial.m} {run.learned.family}, {run.learned.method}"
        lines.append(f"[bold]model[/] n = {trial.n} curvature modes, {how}")
    for i, comparison in enumerate(run.trainings):
        logged = f"{worst_marker(comparison)} RMS under the force as logged"
        if run.posterior is not None:
            rms = float(np.nanmax(fitted_rms(run.posterior)[i]))
            logged = f"{millimetres(rms)} mm RMS in the fit; {logged}; the fit corrects its slow error"
        lines.append(f"[bold]{escape(comparison.name)}[/] worst marker {logged}")
    doubted = run.posterior is not None and bool(run.posterior.doubts)
    return Panel("\n".join(lines), expand=False, border_style="red" if doubted else "green")


def show_run(console: Console, run: Findings, seconds: Mapping[str, float], out: Path) -> None:
    """All that `onebend learn` says in the end."""
    parts: list[RenderableType] = []
    if run.learned is not None:
        parts.append(selection_table(run.learned))
    parts += [stiffness_plot(run.beam)] if run.posterior is None else _fit(run, run.posterior)
    parts.append(comparison_table(run.trainings, "Learned from"))
    if run.validations:
        parts.append(comparison_table(run.validations, "Validation"))
    parts += [remarks_list(all_remarks(run)), stages_table(seconds, run.video_seconds), headline(run)]
    for part in parts:
        console.print(part)
        console.print()
    say_path(console, "report", out / "report.html")


def _fit(run: Findings, posterior: Posterior) -> list[RenderableType]:
    """The estimate beside the paper's, where it is blind, and what else was fitted."""
    uncertain = posterior.stiffness
    forced = any(recording.source.clean_force is not None for recording in run.recordings)
    blind = unidentified_words(uncertain, len(run.recordings))
    found: list[RenderableType] = [band_plot(uncertain), estimate_table(uncertain, run.learned)]
    force = [gain_words(posterior.gain_sd, forced=forced), *load_error_words(posterior.load_error)]
    found.append(_sentences([*blind, *force]))
    if posterior.attributions:
        found.append(allowance_table(posterior))
    found.append(nuisance_table(posterior.nuisances()))
    words = tradeoff_words(posterior)
    return [*found, _sentences(["Hardly told apart:", *words])] if words else found


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


def show_model(console: Console, stored: StoredModel) -> None:
    """What `onebend show` draws."""
    beam, origin, uncertain = stored.beam, stored.origin, stored.uncertain
    if uncertain is None:
        console.print(stiffness_plot(beam))
    else:
        console.print(band_plot(uncertain))
        console.print(estimate_table(uncertain, None))
        for text in unidentified_words(uncertain):
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
