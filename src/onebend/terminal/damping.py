"""What `onebend damp` says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from onebend.learning.swing.damping import Damping, SwingFit
from onebend.report.wording import significant
from onebend.terminal.parts import remarks_list


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
