"""What `onebend calibrate` says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from onebend.recording.calibration.intrinsics import NAMES, Calibration
from onebend.terminal.parts import remarks_list


def show_calibration(console: Console, calibration: Calibration, out: Path) -> None:
    """All that `onebend calibrate` says."""
    table = Table(title="The camera", title_justify="left", box=None)
    for name in ("", "value", "sd"):
        table.add_column(name, justify="right" if name else "left")
    for name, value, sd in zip(NAMES, calibration.values, calibration.sd, strict=True):
        if name != "k3" or value != 0.0:
            unit = " \\[px]" if name in NAMES[:4] else ""
            table.add_row(f"{name}{unit}", f"{value:.2f}" if unit else f"{value:.5f}", f"{sd:.2g}")
    console.print(table)
    console.print(
        f"\n{len(calibration.frames)} views; corners {calibration.error:.3f} px from the model (RMS), worst view "
        f"{calibration.view_error.max():.3f} px; corners in {100 * calibration.coverage:.0f} % of the picture; the "
        f"board turned by up to {np.rad2deg(calibration.turned):.0f} degrees.\n",
        highlight=False,
    )
    console.print(remarks_list([("camera", remark) for remark in calibration.remarks]))
    console.print(f"\nWrote {out}; put it into recording.toml:\n", markup=False, highlight=False, soft_wrap=True)
    typer.echo(calibration.camera_table())
