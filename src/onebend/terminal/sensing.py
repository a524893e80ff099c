"""What `onebend sense` says."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from rich.console import Console

from onebend.learning.sensing.sense import Sensed
from onebend.report.wording import significant
from onebend.terminal.parts import facts_table, force_words, remarks_list, say_written


def show_sensed(console: Console, found: Sensed, output: Path | None) -> None:
    """When something touched the beam, the largest force, and how sure it is in which direction."""
    table, peak = facts_table(), found.peak
    table.add_row("frames", f"{len(found.time)}, {int(np.sum(found.touched))} of them show a force")
    for one in found.contacts:
        table.add_row("contact", f"from {one.begin:.3f} to {one.end:.3f} s")
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
    if found.misfit is not None:
        table.add_row("misfit", f"{found.misfit.ratio:.2f} times what band, mounting and noise let expect (squared)")
    difference = found.against_log
    if difference is not None:
        table.add_row("against the log", f"{significant(difference[0])} N RMS where the force is known best")
    console.print(table, highlight=False)
    console.print(remarks_list([(found.name, one) for one in found.remarks]))
    say_written(console, output, "force.csv, force.png, summary.json")


def _place(found: Sensed, t: int) -> str:
    if found.settings.place == "known":
        return f"s = {found.place[t]:.3g}, as said"
    if not math.isnan(found.other_place[t]):
        return f"two places explain it about as well; one is s = {found.other_place[t]:.2g}"
    if math.isnan(found.place[t]):
        return "not told by the shape"
    return f"s = {found.place[t]:.3f} ± {1.96 * found.place_sd[t]:.2g}"
