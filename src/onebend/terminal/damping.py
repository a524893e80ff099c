"""What `onebend damp`, `onebend frequencies` and `onebend sense` say."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from onebend.learning.swing.damping import Damping, SwingFit
from onebend.learning.swing.swing_frequencies import FoundFrequencies
from onebend.records import Array
from onebend.report.wording import significant
from onebend.terminal.parts import facts_table, force_words, remarks_list, say_written

_AS_SAID = 5e-4  # of s: a place that comes out nearer is the one that was said

if TYPE_CHECKING:  # for the types alone: `show` says what damping is, and loads no search
    from onebend.learning.endings.edge import Edge
    from onebend.learning.sensing.sensed import Sensed
    from onebend.learning.sensing.sensor import SensorCheck


def damping_words(damping: Damping) -> str:
    """One sentence."""
    return (
        f"damping d / k = {1000 * damping.loss_time:.3g} ms (sd {1000 * damping.loss_time_sd:.2g}), "
        f"{damping.frequency[0]:.4g} Hz at a damping ratio of {damping.ratio[0]:.3g}, "
        f"from the swing in {damping.recording}"
    )


def swing_table(fit: SwingFit) -> Table:
    """What the swing says, one quantity a row."""
    table = Table(title="From the free swing", title_justify="left", box=None)
    for name in ("", "value", "sd"):
        table.add_column(name, justify="left" if not name else "right")
    damping = fit.damping
    table.add_row("loss time d / k \\[ms]", f"{1e3 * damping.loss_time:.4g}", f"{1e3 * damping.loss_time_sd:.2g}")
    table.add_row("natural frequency \\[Hz]", f"{damping.frequency[0]:.5g}", f"{damping.frequency_sd:.2g}")
    table.add_row("damping ratio", f"{damping.ratio[0]:.4g}", f"{damping.ratio_sd:.2g}")
    for i in range(1, len(damping.frequency)):
        table.add_row(f"mode {i + 1}, simulated", f"{damping.frequency[i]:.4g} Hz", f"ratio {damping.ratio[i]:.3g}")
    if fit.mass_known:
        sd = float(np.hypot(fit.factor_sd, fit.model_sd))
        table.add_row("k over mass, times the model's", f"{fit.factor:.4g}", f"{sd:.2g}" if np.isfinite(sd) else "?")
    else:
        table.add_row(
            "mass \\[g]", significant(1000 * fit.mass), f"{1000 * fit.mass_sd:.2g}" if np.isfinite(fit.mass_sd) else "?"
        )
    return table


def frequency_table(found: FoundFrequencies) -> Table:
    """One mode a row."""
    table = Table(title="Frequencies of the free swing", title_justify="left", box=None)
    for name in ("Hz", "sd", "damping ratio", "sd", "size"):
        table.add_column(name, justify="right")
    table.add_column("")
    for one in found.modes:
        said = f"a multiple of {one.multiple_of:.4g} Hz" if one.multiple_of else ""
        cells = (f"{one.damping_ratio:.3g}", f"{one.damping_ratio_sd:.2g}", f"{100 * one.share:.3g} %", said)
        table.add_row(f"{one.frequency:.6g}", f"{one.sd:.2g}", *cells)
    return table


def frequency_entries(found: FoundFrequencies) -> str:
    """What to write in recording.toml: the slowest is taken to be mode 1, and learning numbers the others."""
    rows = []
    for i, one in enumerate(one for one in found.modes if not one.multiple_of):
        mode = "mode = 1\n" if i == 0 else ""
        numbers = f"hz = {one.frequency:.6g}\nsd_hz = {one.sd:.2g}\ndamping_ratio = {one.damping_ratio:.3g}\n"
        rows.append(f"[[frequencies]]\n{numbers}{mode}base_angle_deg =    # -90 hangs, 90 stands, 0 lies\n")
    return "\n".join(rows)


def show_frequencies(console: Console, found: FoundFrequencies) -> None:
    """All that `onebend frequencies` says."""
    console.print(frequency_table(found))
    console.print(
        f"\n{found.samples} samples from {found.begin:.2f} to {found.end:.2f} s at {found.rate:.4g} a second; "
        f"{100 * found.left:.2g} % of the motion is in no mode.\n",
        highlight=False,
    )
    if found.remarks:
        console.print(remarks_list([(found.name, remark) for remark in found.remarks]))
        console.print()
    console.print("For recording.toml:\n", highlight=False)
    console.print(frequency_entries(found), markup=False, highlight=False)


def show_damping(console: Console, fit: SwingFit, out: Path | None) -> None:
    """All that `onebend damp` says."""
    end = fit.swing.begin + float(fit.swing.time[-1])
    console.print(swing_table(fit))
    rms = ", ".join(f"{1000 * value:.2g}" for value in fit.rms)
    console.print(
        f"\n{len(fit.swing.time)} frames from {fit.swing.begin:.2f} to {end:.2f} s of the film; the tags are {rms} mm "
        "(RMS) from the fitted motion.\n",
        highlight=False,
    )
    console.print(remarks_list([(fit.swing.name, remark) for remark in fit.remarks]))
    if out is not None:
        console.print(f"\nWrote {out}.", markup=False, highlight=False, soft_wrap=True)


def show_sensed(console: Console, found: Sensed, output: Path | None, *, bag: bool = False) -> None:
    """When something touched the beam, the largest force, and how sure it is in which direction."""
    table, peak = facts_table(), found.peak
    table.add_row("frames", f"{len(found.time)}, {int(np.sum(found.touched))} of them show a force")
    for one in found.contacts:
        table.add_row("contact", f"{_when('from', one.begin, 'before')} {_when('to', one.end, 'after')} (95 %)")
    if peak is None:
        table.add_row("force", "none that leaves its 95 % region at zero")
    else:
        table.add_row("largest force", f"{force_words(found.force[peak])}, at {found.time[peak]:.3f} s")
        weak = math.degrees(found.weak_angle[peak])
        strong = significant(1.96 * float(found.strong_sd[peak]))
        table.add_row("sure to within", f"± {strong} N at {(weak + 90.0) % 180.0:.0f} deg, where it is known best")
        table.add_row("", f"± {significant(1.96 * float(found.weak_sd[peak]))} N at {weak:.0f} deg, where least (95 %)")
        share = 100.0 * found.prior_share[peak]
        table.add_row("from the prior", f"{share[0]:.2g} % of x, {share[1]:.2g} % of y (sd {found.prior_sd:.3g} N)")
        table.add_row("place", _place(found, peak))
        for row in _more_rows(found, peak):
            table.add_row(*row)
        if found.smoothed is not None:
            smooth, sd = found.smoothed.force[peak], np.sqrt(np.diag(found.smoothed.covariance[peak]))
            said = f"{force_words(smooth)}, x ± {1.96 * sd[0]:.2g} N, y ± {1.96 * sd[1]:.2g} N (95 %)"
            table.add_row("smoothed there", said)
    if found.misfit is not None:
        table.add_row("misfit", f"{found.misfit.ratio:.3g} times what band, mounting and noise let expect (squared)")
    difference = found.against_log
    if difference is not None:
        table.add_row("against the log", f"{significant(difference[0])} N RMS where the force is known best")
    for row in sensor_rows(found.sensor):
        table.add_row(*row)
    console.print(table, highlight=False)
    console.print(remarks_list([(found.name, one) for one in found.remarks]))
    say_written(console, output, f"force.csv, force.png, {'force.mcap, ' if bag else ''}regions.png, summary.json")


def sensor_rows(check: SensorCheck | None) -> list[tuple[str, str]]:
    """The force log as the shape judges it, with 95 % bands."""
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


def _more_rows(found: Sensed, peak: int) -> list[tuple[str, str]]:
    """The moment, and the second force, where they were asked for."""
    rows, moment, two, second = [], found.moment, found.two, found.second
    if moment is not None:
        value, share = f"{moment.moment[peak]:.3g} ± {1.96 * moment.sd[peak]:.2g} N m (95 %)", moment.prior_share[peak]
        rows.append(("its moment", f"{value}, {100.0 * share:.2g} % from the prior (sd {moment.prior_sd:.3g} N m)"))
    if two is not None:
        rows.append(("two contacts", f"log evidence {two.evidence:.3g} against one"))
        for near, far in two.others:
            rows.append(("", f"places s = {near:.2f} and {far:.2f} explain the shapes about as well"))
    if second is not None:
        sd = np.sqrt(np.diag(second.covariance[peak]))
        said = f"{force_words(second.force[peak])}, x ± {1.96 * sd[0]:.2g} N, y ± {1.96 * sd[1]:.2g} N (95 %)"
        rows.append(("second force", said))
        place = f"s = {second.place:.3f} ± {1.96 * second.place_sd:.2g}"
        rows.append(("its place", "not told by the shape" if math.isnan(second.place) else place))
    return rows


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
