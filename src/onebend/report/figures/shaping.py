"""Pictures of a shape that hands hold, and of a path."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from onebend.beam.model import Beam
from onebend.control.path.follow import FollowedPath
from onebend.control.shape.shape import ShapeResult
from onebend.records import Array
from onebend.report.figures.style import BLUE, GREEN, INK, MUTED, ORANGE, blank, colour, plane, styled
from onebend.report.wording import significant

MM = 1000.0
ARROW = 0.22  # of L, of the largest force
TICK = 0.06  # of L: a wanted direction, and half a gripper's jaw
SNAPSHOTS = 7
S = np.linspace(0.0, 1.0, 121)


@styled
def shaping(beam: Beam, result: ShapeResult) -> Figure:
    """The beam in its found shape, what was wanted, and what holds it there."""
    figure, (axes,) = blank(4.4)
    resting = beam.equilibrium([0.0, 0.0]).xy(S)
    axes.plot(*(MM * resting.T), color=MUTED, lw=1.2, label="at rest")
    if result.spread is not None:
        _spread(axes, result)
    axes.plot(*(MM * result.xy(S).T), color=BLUE, lw=2.4, label="held")
    _targets(axes, result, beam.length)
    largest = max(float(np.max(np.hypot(*result.forces.T), initial=0.0)), 1e-300)
    for pusher, force in zip(result.state.actuators.pushes, result.forces, strict=True):
        _arrow(axes, result.xy(pusher.at_s)[0], ARROW * beam.length * force / largest)
        axes.plot([], [], color=ORANGE, label=f"{significant(float(np.hypot(*force)))} N at s = {pusher.at_s:.3g}")
    if result.wrench is not None:
        _jaw(axes, result.pose, beam.length)
        axes.plot([], [], color=ORANGE, lw=5, label="gripper")
    limits = f"; held back by {', '.join(result.limits)}" if result.limits else ""
    plane(axes, f"{MM * result.rms:.3g} mm rms from the targets{limits}", adjustable="datalim")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


@styled
def path_figure(way: FollowedPath) -> Figure:
    """The beam on its way, what the hands do in time, and what is missing to the goals."""
    figure, (places, acting, lag) = blank(8.2, rows=3, gridspec_kw={"height_ratios": [2.4, 1.4, 0.8]})
    shown = np.unique(np.round(np.linspace(0, len(way.time) - 1, SNAPSHOTS)).astype(int))
    shapes = way.actuators.solved(way.q[shown], way.u[shown]).xy(S)
    for j, one in enumerate(shapes):
        places.plot(*(MM * one.T), color=BLUE, alpha=0.25 + 0.75 * j / max(len(shown) - 1, 1), lw=1.4)
    wanted, _ = way.goals.along(np.linspace(way.goals.time[0], way.goals.time[-1], 400))
    for i in np.flatnonzero(way.goals.targets.placed):
        places.plot(*(MM * wanted[:, i].T), color=ORANGE, lw=1.2)
        places.plot(*(MM * way.goals.xy[:, i].T), "x", color=ORANGE, markersize=4)
    title = f"{len(shown)} of {len(way.time)} samples, the last the darkest; goals in orange"
    plane(places, title, adjustable="datalim")
    _hands_in_time(acting, way)
    lag.plot(way.time, MM * way.miss, color=INK, lw=1.6, clip_on=False)
    lag.set(xlabel="time [s]", ylabel="miss [mm]", title="Distance from the goals, rms")
    lag.set_ylim(0.0, max(1.1 * MM * float(np.max(way.miss)), 1e-3))
    return figure


def _hands_in_time(axes: Axes, way: FollowedPath) -> None:
    """Forces of the pushes; of a grip the pose."""
    for i, pusher in enumerate(way.actuators.pushes):
        axes.plot(way.time, way.forces[:, i, 0], color=colour(i), label=f"$F_x$ at s = {pusher.at_s:.3g}")
        axes.plot(way.time, way.forces[:, i, 1], "--", color=colour(i), label=f"$F_y$ at s = {pusher.at_s:.3g}")
    stretch = f", stretched {way.stretch:.2f} times" if way.stretch > 1.0 + 1e-6 else ""
    axes.set(ylabel="force [N]" if way.actuators.pushes else "gripper [mm, deg]", title=f"{_acting(way)}{stretch}")
    other = axes.twinx() if way.actuators.pushes and way.wrench is not None else axes
    if way.wrench is not None:
        x, y, angle = way.poses.T
        rows = ((MM * x, "x [mm]", "-"), (MM * y, "y [mm]", "--"), (np.degrees(angle), "angle [deg]", ":"))
        for values, name, style in rows:
            other.plot(way.time, values, style, color=GREEN, label=f"gripper {name}")
    if other is not axes:
        other.set_ylabel("gripper [mm, deg]")
        other.legend(loc="center left", bbox_to_anchor=(1.08, 0.15))
    axes.legend(loc="center left", bbox_to_anchor=(1.0 if other is axes else 1.08, 0.5))


def _acting(way: FollowedPath) -> str:
    if way.wrench is None:
        return "Force" if len(way.actuators.pushes) == 1 else "Forces"
    return "Forces and gripper" if way.actuators.pushes else "Gripper"


def _spread(axes: Axes, result: ShapeResult) -> None:
    """Two standard deviations, where positions are wanted, by the band on k(s)."""
    assert result.spread is not None
    at, sd = MM * result.xy(result.targets.s), 2.0 * MM * result.spread.xy
    label = "2 sd by the band on k(s)"
    axes.errorbar(at[:, 0], at[:, 1], xerr=sd[:, 0], yerr=sd[:, 1], fmt="none", ecolor=GREEN, lw=1.2, label=label)


def _targets(axes: Axes, result: ShapeResult, length: float) -> None:
    targets = result.targets
    wanted = MM * targets.xy[targets.placed]
    axes.plot(*wanted.T, "x", color=ORANGE, markersize=7, markeredgewidth=1.8, zorder=6, label="wanted")
    at = result.xy(targets.s)
    for i in np.flatnonzero(targets.turned):
        way = MM * TICK * length * np.array([np.cos(targets.angle[i]), np.sin(targets.angle[i])])
        ends = np.stack([MM * at[i] - way, MM * at[i] + way])
        label = "wanted direction" if i == np.flatnonzero(targets.turned)[0] else None
        axes.plot(*ends.T, color=ORANGE, lw=1.4, zorder=6, label=label)


def _arrow(axes: Axes, at: Array, force: Array) -> None:
    tail = MM * (at - force)
    style = {"arrowstyle": "-|>", "color": ORANGE, "lw": 1.8}
    axes.annotate("", tuple(MM * at), tuple(tail), arrowprops=style, zorder=7)
    axes.plot(*tail, alpha=0.0)  # so that the arrow is inside the picture


def _jaw(axes: Axes, pose: Array, length: float) -> None:
    across = TICK * length * np.array([-np.sin(pose[2]), np.cos(pose[2])])
    axes.plot(*(MM * np.stack([pose[:2] - across, pose[:2] + across]).T), color=ORANGE, lw=5, zorder=4)
