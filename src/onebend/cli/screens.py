"""Screens of the commands."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console, Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from onebend.beam.model import Beam
from onebend.beam.stiffness import Band, UncertainStiffness
from onebend.cli.common import facts_table, force_words, listing, remarks_list, say_written
from onebend.learning.outcome import Comparison
from onebend.learning.run import Run
from onebend.learning.swing import Damping, FoundFrequencies, SwingFit
from onebend.records import Array, Observations
from onebend.report import confidence, sentences
from onebend.report.sentences import all_remarks, millimetres, pair_remarks, say, significant, worded
from onebend.report.verdict import hopeless, validation_verdict, verdict_of
from onebend.results.model import StoredModel

if TYPE_CHECKING:
    from onebend.learning.sensing.contacts import Edge
    from onebend.learning.sensing.sense import Sensed
    from onebend.learning.sensing.sensor import SensorCheck


WIDE = 91  # columns of a plot with eleven numbers below


def comparison_table(comparisons: Sequence[Comparison], what: str) -> Table:
    """Tables IV to VI, one row per tag: RMS, force noise, likely error."""
    meaning = "force noise: from the log's noise alone; likely: with the band of k(s) and the push's place"
    table = listing(f"{what}: RMS distance ({meaning})", "<recording", "frames")
    table.columns[0].ratio = 1
    table.add_column("tag", no_wrap=True)
    for name in ("s", "RMS \\[mm]", "force noise \\[mm]", "likely \\[mm]"):
        table.add_column(name, justify="right", no_wrap=True)
    for one in comparisons:
        for i, s in enumerate(one.marker_s):
            whose = (escape(one.name), str(len(one.frame))) if i == 0 else ("", "")
            beside = [f"[dim]{millimetres(rms)}[/]" for rms in (one.sensor_rms[i], one.likely_rms[i])]
            table.add_row(*whose, sentences.tag_words(one, i), f"{s:.3g}", millimetres(one.rms[i]), *beside)
    return table


def band_places(columns: int) -> Array:
    """Six or eleven places that fit below a plot."""
    return np.linspace(0.0, 1.0, 11 if columns >= WIDE else 6)


def band_of(known: UncertainStiffness | Beam, s: Array) -> Band:
    """The band at `s`; of a beam alone k itself."""
    if isinstance(known, UncertainStiffness):
        return known.band(s)
    k = np.asarray(known.stiffness(s))
    return Band(s, k, k, k, np.ones(len(s), dtype=bool))


def band_table(
    known: UncertainStiffness | Beam, *, columns: int, modulus: confidence.ModulusRows | None = None
) -> Table:
    """k, its band and Young's modulus at `band_places`, aligned with a plot."""
    s = band_places(columns)
    count, band = len(s), band_of(known, s)
    table = Table(box=None, show_header=False, pad_edge=False, padding=0)
    table.add_column(width=9)
    for i in range(count):
        table.add_column(width=(columns - 1) // (count - 1) if i < count - 1 else None, no_wrap=True)
    styles = ["" if there else "bright_black" for there in band.identified]

    def add(name: str, cells: Sequence[str]) -> None:
        table.add_row(Text(f"{name:>8}", "dim"), *(Text(*pair) for pair in zip(cells, styles, strict=True)))

    add("s", ["0 clamp", *(f"{value:.1f}" for value in s[1:-1]), "1 tip"])
    k, low, high = ([sentences.significant(float(value)) for value in one] for one in (band.k, band.low, band.high))
    rows: list[tuple[str, Sequence[str]]] = [("k [N m]", k)]
    if isinstance(known, UncertainStiffness):
        rows += [("±", confidence.half_widths(band)), ("from", low), ("to", high)]
    if modulus is not None:
        rows += [(f"E [{modulus.unit}]", modulus.values), ("from", modulus.low), ("to", modulus.high)]
    for name, cells in rows:
        add(name, [cell if there else f"({cell})" for cell, there in zip(cells, band.identified, strict=True)])
    return table


MOST = 4.0  # times k: a wider band may leave the plot
CURVE, BAND = ("-", "━"), ("·", "░")  # not identified, identified


def band_plot(known: UncertainStiffness | Beam, *, columns: int = 61, rows: int = 12) -> RenderableType:
    """k(s) in its 95 % band (of a beam alone without one), thin and grey where not identified."""
    s = np.linspace(0.0, 1.0, columns)
    band, sure = band_of(known, s), isinstance(known, UncertainStiffness)
    shown = known.best_known(s) if isinstance(known, UncertainStiffness) else band.identified
    top = max(min(1.05 * float(np.max(band.high[shown])), MOST * float(np.max(band.k[shown]))), 0.0)
    edges = np.linspace(0.0, top, rows + 1)
    lines = []
    for row in range(rows - 1, -1, -1):
        low, high = edges[row], edges[row + 1]
        text = Text(_mark(row, rows, edges), "dim")
        for i in range(columns):
            there = bool(band.identified[i])
            inside = band.high[i] > low and band.low[i] < high
            cell = CURVE[there] if low <= band.k[i] < high else BAND[there] if inside else " "
            text.append(cell, "blue" if there else "bright_black")
        lines.append(text)
    unknown = "" if band.identified.all() else "; - and (): not identified"
    heading = Text(f"k(s) = EI / L [N m]{', with its 95 % band' if sure else ''}{unknown}", "italic")
    return Group(heading, *lines, Text(" " * 9 + "└" + "─" * columns, "dim"))


def _mark(row: int, rows: int, edges: Array) -> str:
    if row not in (0, rows - 1):
        return " " * 9 + "│"
    return f"{sentences.significant(float(edges[-1] if row else edges[0])):>8} ┤"


_AS_SAID = 5e-4  # of s: nearer is the stated place


def damping_words(damping: Damping) -> str:
    first = {"hz": damping.frequency[0], "first_ratio": damping.ratio[0]}  # slowest mode
    return say("damping", **vars(damping), **first)


def swing_table(fit: SwingFit) -> Table:
    table = listing("From the free swing", "<", "value", "sd")
    damping = fit.damping
    table.add_row("loss time d / k \\[ms]", f"{1e3 * damping.loss_time:.4g}", f"{1e3 * damping.loss_time_sd:.2g}")
    table.add_row("natural frequency \\[Hz]", f"{damping.frequency[0]:.5g}", f"{damping.frequency_sd:.2g}")
    table.add_row("damping ratio", f"{damping.ratio[0]:.4g}", f"{damping.ratio_sd:.2g}")
    for i in range(1, len(damping.frequency)):
        table.add_row(f"mode {i + 1}, simulated", f"{damping.frequency[i]:.4g} Hz", f"ratio {damping.ratio[i]:.3g}")
    name, value, sd = "mass \\[g]", significant(1000 * fit.mass), 1000 * fit.mass_sd
    if fit.mass_known:
        name, value = "k over mass, times the model's", f"{fit.factor:.4g}"
        sd = float(np.hypot(fit.factor_sd, fit.model_sd))
    table.add_row(name, value, f"{sd:.2g}" if np.isfinite(sd) else "?")
    return table


def frequency_table(found: FoundFrequencies) -> Table:
    """One row per mode."""
    table = listing("Frequencies of the free swing", "Hz", "sd", "damping ratio", "sd", "size")
    table.add_column("")
    for one in found.modes:
        said = f"a multiple of {one.multiple_of:.4g} Hz" if one.multiple_of else ""
        cells = (f"{one.damping_ratio:.3g}", f"{one.damping_ratio_sd:.2g}", f"{100 * one.share:.3g} %", said)
        table.add_row(f"{one.frequency:.6g}", f"{one.sd:.2g}", *cells)
    return table


def frequency_entries(found: FoundFrequencies) -> str:
    """Lines for recording.toml, as if no mode between them was missed."""
    rows = []
    for i, one in enumerate(one for one in found.modes if not one.multiple_of):
        numbers = f"hz = {one.frequency:.6g}\nsd_hz = {one.sd:.2g}\ndamping_ratio = {one.damping_ratio:.3g}\n"
        rows.append(f"[[frequencies]]\n{numbers}mode = {i + 1}\nbase_angle_deg =    # -90 hangs, 90 stands, 0 lies\n")
    return "\n".join(rows)


def show_frequencies(console: Console, found: FoundFrequencies) -> None:
    console.print(frequency_table(found))
    console.print(say("swing's modes", **vars(found)))
    if found.remarks:
        console.print(remarks_list([(found.name, remark) for remark in worded(found.remarks)]))
        console.print()
    console.print("For recording.toml:\n")
    console.print(frequency_entries(found), markup=False)


def show_damping(console: Console, fit: SwingFit, out: Path | None) -> None:
    end = fit.swing.begin + float(fit.swing.time[-1])
    console.print(swing_table(fit))
    rms = ", ".join(f"{1000 * value:.2g}" for value in fit.rms)
    values = {"frames": len(fit.swing.time), "begin": fit.swing.begin, "end": end, "rms": rms}
    console.print(say("swing's frames", **values))
    console.print(remarks_list([(fit.swing.name, remark) for remark in worded(fit.remarks)]))
    if out is not None:
        console.print(f"\nWrote {out}.", markup=False, soft_wrap=True)


def show_sensed(console: Console, found: Sensed, output: Path | None) -> None:
    table, peak = facts_table(), found.peak
    table.add_row("frames", f"{len(found.time)}, {int(np.sum(found.touched))} of them show a force")
    for one in found.contacts:
        table.add_row("contact", f"{_when('from', one.begin, 'before')} {_when('to', one.end, 'after')} (95 %)")
    if peak is None:
        table.add_row("force", "none that leaves its 95 % region at zero")
    else:
        table.add_row("largest force", f"{force_words(found.force[peak])}, at {found.time[peak]:.3f} s")
        weak = math.degrees(found.weak_angle[peak])
        strong = sentences.significant(1.96 * float(found.strong_sd[peak]))
        table.add_row("sure to within", f"± {strong} N at {(weak + 90.0) % 180.0:.0f} deg, where it is known best")
        table.add_row(
            "", f"± {sentences.significant(1.96 * float(found.weak_sd[peak]))} N at {weak:.0f} deg, where least (95 %)"
        )
        share = 100.0 * found.prior_share[peak]
        weights = f"x {share[0]:.2g} %, y {share[1]:.2g} % (prior sd {found.prior_sd:.3g} N)"
        table.add_row("weight of the prior", weights)
        table.add_row("place", _place(found, peak))
        if found.moment is not None:
            moment, share = found.moment, 100.0 * found.moment.prior_share[peak]
            value = f"{moment.moment[peak]:.3g} ± {1.96 * moment.sd[peak]:.2g} N m (95 %)"
            prior = f"weight of the prior {share:.2g} % (sd {moment.prior_sd:.3g} N m)"
            table.add_row("its moment", f"{value}, {prior}")
    if found.misfit is not None:
        table.add_row("misfit", f"{found.misfit.ratio:.3g} times the expected sum of squares")
    difference = found.against_log
    if difference is not None:
        table.add_row("against the log", f"{sentences.significant(difference[0])} N RMS where the force is known best")
    for row in sensor_rows(found.sensor):
        table.add_row(*row)
    console.print(table)
    console.print(remarks_list([(found.name, one) for one in worded(found.remarks)]))
    say_written(console, output, "force.csv, force.png, summary.json")


def sensor_rows(check: SensorCheck | None) -> list[tuple[str, str]]:
    if check is None:
        return []

    def pair(values: tuple[Array, Array]) -> str:
        return ", ".join(f"{v:.3g} ± {1.96 * sd:.2g}" for v, sd in zip(*values, strict=True))

    turn, turn_sd = (math.degrees(v) for v in check.direction)
    return [
        ("the log's gain", f"{check.gain[0]:.4g} ± {1.96 * check.gain[1]:.2g} (1: right, if the model's k is)"),
        ("its axes turned by", f"{turn:.2g} ± {1.96 * turn_sd:.2g} deg"),
        ("its delay", f"{1e3 * check.delay[0]:.3g} ± {1.96e3 * check.delay[1]:.2g} ms"),
        ("its bias x, y", f"{pair(check.bias)} N"),
        ("its drift x, y", f"{pair(check.drift)} N/s"),
    ]


def _when(word: str, edge: Edge, outside: str) -> str:
    if not math.isfinite(edge.sd):
        return f"{word} {outside} the film"
    return f"{word} {edge.time:.3f} ± {1.96 * edge.sd:.2g} s"


def _place(found: Sensed, t: int) -> str:
    if found.settings.place == "known":
        told = f"s = {found.place[t]:.3g}"
        said = found.settings.at_s
        return told if said is None or abs(found.place[t] - said) < _AS_SAID else f"{told}; said {said:.3g}"
    if not math.isnan(found.other_place[t]):
        return f"two places explain it about as well; one is s = {found.other_place[t]:.2g}"
    if math.isnan(found.place[t]):
        return "not told by the shape"
    return f"s = {found.place[t]:.3f} ± {1.96 * found.place_sd[t]:.2g}"


_COLOURS = {"holds": "green", "holds with allowances": "green", "not to be trusted": "red", "no band": "yellow"}
_FEWEST_ROWS, _MOST_ROWS = 6, 16  # of the plot


def show_run(console: Console, run: Run, out: Path, *, report: bool = True) -> None:
    """The answer of `onebend learn`."""
    console.print(verdict_rows(run))
    console.print()
    for part in [] if hopeless(run) else _stiffness(console, run):
        console.print(part)
    console.print()
    remarks = all_remarks(run)
    warnings = [pair for pair in remarks if pair[1].level == "warning"]
    if warnings:
        console.print(remarks_list(warnings, title=None))
    if notes := len(remarks) - len(warnings):
        what = "1 note is" if notes == 1 else f"{notes} notes are"
        console.print(f"[dim]{what} in {'the report' if report else 'summary.json'}[/]")
    say_path(console, "report" if report else "results", out / "report.html" if report else out)


def verdict_rows(run: Run) -> Table:
    verdict = verdict_of(run)
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="dim")
    table.add_column(overflow="fold")
    table.add_row("verdict", Text(verdict.headline, f"bold {_COLOURS[verdict.grade]}"))
    for label, words in verdict.rows:
        table.add_row(label, Text(words))
    return table


def _stiffness(console: Console, run: Run) -> list[RenderableType]:
    columns = min(max((console.width - 19) // 10, 4), 10) * 10 + 1
    rows = min(max(console.height - 18, _FEWEST_ROWS), _MOST_ROWS)
    measured = confidence.measured_beam(run)
    words = confidence.modulus_words(measured)
    below: list[RenderableType] = [Text("\n".join(words))] if words else []
    known = run.beam if run.posterior is None else run.posterior.stiffness
    modulus = None if run.posterior is None else confidence.modulus_rows(measured, band_places(columns))
    numbers = band_table(known, columns=columns, modulus=modulus)
    return [band_plot(known, columns=columns, rows=rows), numbers, *below]


def say_path(console: Console, what: str, path: Path) -> None:
    """On one line whatever the width, to be copied."""
    console.print(f"[bold]{what}[/] {escape(str(path))}", soft_wrap=True)


def show_validation(console: Console, pairs: Sequence[tuple[Comparison, Observations]], out: Path | None) -> None:
    comparisons = [comparison for comparison, _ in pairs]
    if verdict := validation_verdict(comparisons):
        console.print(Text.assemble(("verdict   ", "dim"), (verdict, "bold")))
    console.print(comparison_table(comparisons, "Validation"))
    remarks = [(one.name, remark) for one, recording in pairs for remark in pair_remarks(one, recording)]
    if remarks:
        console.print()
        console.print(remarks_list(remarks, title=None))
    if out is not None:
        say_path(console, "\ntables and figures", out)


def show_model(console: Console, stored: StoredModel) -> None:
    beam, origin, uncertain = stored.beam, stored.origin, stored.uncertain
    measured = confidence.MeasuredBeam(beam, uncertain, stored.section)
    known = beam if uncertain is None else uncertain
    modulus = None if uncertain is None else confidence.modulus_rows(measured, band_places(61))
    console.print(band_plot(known))
    console.print(band_table(known, columns=61, modulus=modulus))
    for text in () if uncertain is None else confidence.unidentified_words(uncertain):
        console.print(text, markup=False)
    for text in confidence.modulus_words(measured):
        console.print(text, markup=False)
    lowest = float(beam.stiffness(np.linspace(0.0, 1.0, 401)).min())
    if lowest <= 0.0:
        console.print(
            f"[yellow]k(s) falls to {sentences.significant(lowest)} N m: this is no beam and cannot be simulated.[/]"
        )
    console.print(f"\nlength {1000 * beam.length:.4g} mm")
    if stored.damping is not None:
        console.print(damping_words(stored.damping), markup=False)
    if origin is not None:
        modes = "" if origin.n is None else f"n = {origin.n}, "
        text = f"learned from {origin.recording} by {origin.method}: {modes}m = {origin.m} {origin.family}"
        console.print(text, markup=False)
