"""What `onebend shape` and `onebend path` say."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from onebend.control.path.follow import FollowedPath
from onebend.control.path.path_spread import PathSpread
from onebend.control.shape.shape import ShapeResult
from onebend.report.wording import length_words, significant
from onebend.terminal.parts import NO_BAND, facts_table, force_words, say_written


def show_shape(console: Console, result: ShapeResult, output: Path | None) -> None:
    """The actuators' loads, the residual, the distance from buckling, the uncertainty."""
    table = facts_table()
    for pusher, force in zip(result.state.actuators.pushes, result.forces, strict=True):
        table.add_row(f"force at s = {pusher.at_s:.3g}", force_words(force))
    if result.wrench is not None:
        x, y, angle = result.pose
        table.add_row("gripper", f"[bold]({1e3 * x:.3f}, {1e3 * y:.3f}) mm at {math.degrees(angle):.2f} deg[/]")
        table.add_row(
            "it puts on the beam", f"({result.wrench[0]:.4g}, {result.wrench[1]:.4g}) N and {result.wrench[2]:.4g} N m"
        )
    table.add_row("from the targets", f"{length_words(result.rms, 3)} rms: {_why(result)}")
    table.add_row("from buckling", f"margin {result.margin:.3f} (1 without loads, 0 where it buckles)")
    table.add_row("sure to within", _sureness(result))
    console.print(table, highlight=False)
    for warning in result.warnings:
        console.print(f"[yellow]![/] {escape(warning)}", highlight=False)
    say_written(console, output, "shape.csv, targets.csv, shape.png, summary.json")


def _why(result: ShapeResult) -> str:
    if result.limits:
        return f"held back by {escape(', '.join(result.limits))}"
    return "the closest that was found" if result.rms > 1e-9 else "they are met"


def _sureness(result: ShapeResult) -> str:
    if result.spread is None:
        return NO_BAND
    return f"{length_words(2.0 * result.spread.rms)} (2 sd over the targets' places, from the band on k(s))"


def show_path(console: Console, way: FollowedPath, sure: PathSpread | None, output: Path | None, *, bag: bool) -> None:
    """Length, stretch, forces, misses, margin; `bag`: whether a ROS 2 bag was written with the other files."""
    table = facts_table()
    stretch = f", {way.stretch:.2f} times the goals'" if way.stretch > 1.0 + 1e-6 else ""
    table.add_row("samples", f"{len(way.time)} over {way.time[-1]:.3f} s{stretch}")
    for pusher, force in zip(way.actuators.pushes, np.moveaxis(way.forces, 1, 0), strict=True):
        table.add_row(f"force at s = {pusher.at_s:.3g}", f"up to {significant(float(np.max(np.hypot(*force.T))))} N")
    if way.wrench is not None:
        table.add_row("gripper's force", f"up to {significant(float(np.max(np.hypot(*way.wrench[:, :2].T))))} N")
    table.add_row("from the goals", f"at worst {length_words(float(np.max(way.miss)))} rms in the model")
    table.add_row("sure to within", _path_sureness(sure))
    table.add_row(
        "from buckling", f"margin at least {float(np.min(way.margin)):.3f} (1 without loads, 0 where it buckles)"
    )
    console.print(table, highlight=False)
    for warning in way.warnings:
        console.print(f"[yellow]![/] {escape(warning)}", highlight=False)
    messages = "YAML and bag" if bag else "YAML; for a bag: pip install 'onebend[ros]'"
    say_written(console, output, f"path.csv, ROS 2 messages ({messages}), path.png, summary.json")


def _path_sureness(sure: PathSpread | None) -> str:
    if sure is None:
        return NO_BAND
    worst = int(np.argmax(sure.rms))
    most = length_words(2.0 * float(sure.rms[worst]))
    return f"{most} at worst, at {sure.time[worst]:.3g} s (2 sd, from the band on k(s))"
