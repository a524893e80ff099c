"""Pictures of goals, shapes, paths, loops and sensed forces."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from onebend.beam.model import Beam
from onebend.control import loop, loop_simulation, path, reach_set, shape
from onebend.control.reach import SURE, PredictedError, Reach, ReachInSetUp
from onebend.learning.sensing.sense import WIDE, Sensed
from onebend.records import Array
from onebend.report.sentences import significant
from onebend.report.style import BLUE, FAINT, GREEN, INK, MUTED, ORANGE, blank, hue_of, plane, styled

MM = 1000.0
ARROW = 0.22  # of L, for the largest force
TORN = 0.25  # of L: samples farther apart are on two sheets


@styled
def reaching(
    result: Reach | ReachInSetUp, error: PredictedError | None = None, within: reach_set.ReachableSet | None = None
) -> Figure:
    """The beam on its way to the goal (Fig. 8), the force, and the uncertainty of the point."""
    figure, (axes,) = blank(4.2)
    if within is not None:
        draw_reachable(axes, within)
    draw_reach(axes, result, error)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def draw_reach(axes: Axes, result: Reach | ReachInSetUp, error: PredictedError | None) -> None:
    s = np.linspace(0.0, 1.0, 121)
    shapes = result.shapes(s)
    chosen = np.unique(np.round(np.linspace(0, len(shapes) - 1, 6)).astype(int))
    for i in chosen:
        last, rest = i == chosen[-1], i == 0
        label = "under the force" if last else "at rest" if rest else "on the way" if i == chosen[1] else None
        colour = MUTED if rest else BLUE
        strength = 1.0 if last or rest else 0.2 + 0.4 * i / max(chosen[-1], 1)
        axes.plot(*(MM * shapes[i].T), color=colour, alpha=strength, lw=2.4 if last else 1.3, label=label)
    axes.plot(*(MM * result.path_points.T), ":", color=INK, lw=1.0, label="the point's way")
    axes.plot(*(MM * result.goal[:2]), "x", color=ORANGE, markersize=11, markeredgewidth=2.2, zorder=6, label="goal")
    axes.plot(*(MM * result.reached[:2]), "o", color=BLUE, markersize=5.5, zorder=5)
    _reach_arrow(axes, result, MM * result.shapes(np.array([result.push_s]))[-1, 0])
    if error is not None:
        outline = MM * (error.mean + error.ellipse(SURE).outline())
        axes.plot(*outline.T, color=GREEN, lw=1.6, zorder=8, label=f"{100 * SURE:.0f} % of the places")
    plane(axes, f"{significant(float(np.hypot(*result.force)))} N at s = {result.push_s:.3g}: {_outcome(result)}")


def _outcome(result: Reach | ReachInSetUp) -> str:
    where = f"the point s = {result.point_s:.3g}" if result.tag is None else f"the centre of tag {result.tag}"
    return f"{where} is on its goal" if result.converged else f"{where} is {MM * result.error:.3g} mm from its goal"


def _reach_arrow(axes: Axes, result: Reach | ReachInSetUp, at: Array) -> None:
    size = float(np.hypot(*result.force))
    if size == 0.0:
        return
    head = at + MM * ARROW * result.beam.length * result.force / size
    _arrow(axes, at, head, far=head)
    axes.plot([], [], color=ORANGE, label="force")


def _arrow(axes: Axes, tail: Array, head: Array, *, far: Array) -> None:
    """An arrow in mm that is wholly inside the picture."""
    axes.annotate("", tuple(head), tuple(tail), arrowprops={"arrowstyle": "-|>", "color": ORANGE, "lw": 1.8}, zorder=7)
    axes.plot(*far, alpha=0.0)


def draw_reachable(axes: Axes, within: reach_set.ReachableSet) -> None:
    """Cells between samples, darker for larger forces; none where the beam would jump."""
    rest = np.broadcast_to(within.pushed.pose(within.pushed.start.q)[:2], (len(within.points), 1, 2))
    rings = np.concatenate([rest, within.points], axis=1)
    around = np.concatenate([rings, rings[:1]])
    cells = np.stack([around[:-1, :-1], around[1:, :-1], around[1:, 1:], around[:-1, 1:]], axis=2)
    sides = np.linalg.norm(cells - np.roll(cells, 1, axis=2), axis=-1).max(axis=-1)
    size = np.broadcast_to(np.linalg.norm(within.force, axis=-1), sides.shape)
    whole = sides < TORN * float(within.pushed.problem.length)  # also excludes NaN
    mesh = PolyCollection(
        list(MM * cells[whole]), array=size[whole], cmap="Blues", alpha=0.55, edgecolors="face", linewidths=0.3
    )
    mesh.set_clim(0.0, 1.25 * within.max_force)
    axes.add_collection(mesh)
    axes.autoscale_view()
    bar = axes.figure.colorbar(mesh, ax=axes, shrink=0.6, pad=0.01, location="left")
    bar.set_label("force that holds the point there [N]")
    bar.ax.set_ylim(0.0, within.max_force)


TICK = 0.06  # of L: a wanted direction, half a gripper's jaw
S = np.linspace(0.0, 1.0, 121)


@styled
def shaping(beam: Beam, result: shape.ShapeResult) -> Figure:
    """The shape, its targets and its loads."""
    figure, (axes,) = blank(4.4)
    resting = beam.equilibrium([0.0, 0.0]).xy(S)
    axes.plot(*(MM * resting.T), color=MUTED, lw=1.2, label="at rest")
    if result.spread is not None:
        _spread(axes, result)
    axes.plot(*(MM * result.xy(S).T), color=BLUE, lw=2.4, label="held")
    _targets(axes, result, beam.length)
    largest = max(float(np.max(np.hypot(*result.forces.T), initial=0.0)), 1e-300)
    for pusher, force in zip(result.state.actuators.pushes, result.forces, strict=True):
        at = result.xy(pusher.at_s)[0]
        tail = MM * (at - ARROW * beam.length * force / largest)
        _arrow(axes, tail, MM * at, far=tail)
        axes.plot([], [], color=ORANGE, label=f"{significant(float(np.hypot(*force)))} N at s = {pusher.at_s:.3g}")
    if result.wrench is not None:
        _jaw(axes, result.pose, beam.length)
        axes.plot([], [], color=ORANGE, lw=5, label="gripper")
    limits = f"; held back by {', '.join(result.limits)}" if result.limits else ""
    plane(axes, f"{MM * result.rms:.3g} mm rms from the targets{limits}", adjustable="datalim")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


@styled
def path_figure(way: path.FollowedPath) -> Figure:
    """The beam on its way, the controls in time, and the distance from the goals."""
    figure, (places, acting, lag) = blank(8.2, rows=3, gridspec_kw={"height_ratios": [2.4, 1.4, 0.8]})
    shown = np.unique(np.round(np.linspace(0, len(way.time) - 1, 7)).astype(int))
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


def _hands_in_time(axes: Axes, way: path.FollowedPath) -> None:
    for i, pusher in enumerate(way.actuators.pushes):
        axes.plot(way.time, way.forces[:, i, 0], color=hue_of(i), label=f"$F_x$ at s = {pusher.at_s:.3g}")
        axes.plot(way.time, way.forces[:, i, 1], "--", color=hue_of(i), label=f"$F_y$ at s = {pusher.at_s:.3g}")
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


def _acting(way: path.FollowedPath) -> str:
    if way.wrench is None:
        return "Force" if len(way.actuators.pushes) == 1 else "Forces"
    return "Forces and gripper" if way.actuators.pushes else "Gripper"


def _spread(axes: Axes, result: shape.ShapeResult) -> None:
    assert result.spread is not None
    at, sd = MM * result.targets.places(result.state.solved)[0], 2.0 * MM * result.spread.xy
    label = "2 sd by the band on k(s)"
    axes.errorbar(at[:, 0], at[:, 1], xerr=sd[:, 0], yerr=sd[:, 1], fmt="none", ecolor=GREEN, lw=1.2, label=label)


def _targets(axes: Axes, result: shape.ShapeResult, length: float) -> None:
    targets = result.targets
    wanted = MM * targets.xy[targets.placed]
    axes.plot(*wanted.T, "x", color=ORANGE, markersize=7, markeredgewidth=1.8, zorder=6, label="wanted")
    at = result.xy(targets.s)
    for i in np.flatnonzero(targets.turned):
        way = MM * TICK * length * np.array([np.cos(targets.angle[i]), np.sin(targets.angle[i])])
        ends = np.stack([MM * at[i] - way, MM * at[i] + way])
        label = "wanted direction" if i == np.flatnonzero(targets.turned)[0] else None
        axes.plot(*ends.T, color=ORANGE, lw=1.4, zorder=6, label=label)


def _jaw(axes: Axes, pose: Array, length: float) -> None:
    across = TICK * length * np.array([-np.sin(pose[2]), np.cos(pose[2])])
    axes.plot(*(MM * np.stack([pose[:2] - across, pose[:2] + across]).T), color=ORANGE, lw=5, zorder=4)


LEAST = 1e-5  # m: lower end of the logarithmic axis
LINES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."))


@styled
def looping(control: loop.Controller, trials: tuple[loop_simulation.LoopTrial, ...]) -> Figure:
    """One curve per beam."""
    figure, (away, force) = blank(5.0, 2, 1)
    for i, trial in enumerate(trials):
        if trial.run is None:
            continue
        colour, dash = LINES[1 if trial.beam.drawn else i]
        name = "k(s) as the model" if trial.beam.factor == 1.0 else f"k(s) times {trial.beam.factor:.3g}"
        if trial.beam.drawn:  # one legend entry for all
            name = "k(s) drawn from its band" if i == 1 else ""
        away.semilogy(trial.run.time, MM * np.maximum(trial.run.error, LEAST), color=colour, ls=dash)
        force.plot(trial.run.time, np.hypot(*trial.run.asked.T), color=colour, ls=dash, label=name)
    away.axhline(MM * loop_simulation.SETTLED, color=MUTED, lw=1.0, ls=":")
    x, y = MM * control.goal
    away.set(ylabel="from the goal [mm]", title=f"The loop, simulated: goal at ({x:.4g}, {y:.4g}) mm")
    _said(away, MM * loop_simulation.SETTLED, f"settled: {MM * loop_simulation.SETTLED:.3g} mm")
    ahead = float(np.hypot(*control.reference.ends))
    force.axhline(ahead, color=MUTED, lw=1.0, ls=":")
    _said(force, ahead, "feedforward")
    force.legend(loc="lower right")  # forces begin at 0 and stay
    force.set(xlabel="time [s]", ylabel="force asked for [N]", ylim=(0.0, None))
    return figure


def _said(axes: Axes, height: float, text: str) -> None:
    axes.text(0.01, 1.03 * height, text, fontsize=8, color=MUTED, va="bottom", transform=axes.get_yaxis_transform())


_FROM_PRIOR = 0.25  # remaining share of a component's prior variance, from which it is shaded
_BEYOND = 1.6  # of the largest force: limit of the axes


@styled
def sensing(found: Sensed) -> Figure:
    """Force and moment in time with bands, log, place, misfit and contacts."""
    more = int(found.moment is not None)
    figure, (x, y, *others, place, misfit) = blank(8.0 + 1.6 * more, 4 + more, 1, sharex=True)
    if found.moment is not None:
        _band(others[0], found.time, found.moment.moment, found.moment.sd, ORANGE)
        others[0].set_ylabel("moment [N m]")
    for c, (axes, name, colour) in enumerate(((x, "x", BLUE), (y, "y", GREEN))):
        _component(axes, found, c, name, colour)
    x.set_title("Force from the shape, 95 % bands", loc="left")
    said = {name: one for axes in (y, x) for one, name in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(said.values(), said, loc="outside upper right", ncols=4)  # above the title, never on it
    low, high = found.place - WIDE * found.place_sd, found.place + WIDE * found.place_sd
    shown = found.touched
    place.fill_between(found.time, low, high, where=shown, color=ORANGE, alpha=0.25, lw=0.0)
    place.plot(found.time, np.where(shown, found.place, np.nan), color=ORANGE)
    place.plot(found.time, found.other_place, "x", color=MUTED, markersize=3)
    place.set(ylabel="place s", ylim=(0.0, 1.05))
    misfit.plot(found.time, found.chi2, ".", color=INK, markersize=2.5)
    misfit.set(ylabel="squared misfit", xlabel="time [s]", ylim=(0.0, None))
    for axes in (x, y, *others, place, misfit):
        for one in found.contacts:
            axes.axvspan(one.first, one.last, color=MUTED, alpha=0.08, lw=0.0)
            for edge in (one.begin, one.end):
                if np.isfinite(edge.sd):
                    half = WIDE * edge.sd
                    axes.axvspan(edge.time - half, edge.time + half, color=ORANGE, alpha=0.2, lw=0.0)
    return figure


def _band(axes: Axes, time: Array, middle: Array, sd: Array, colour: str, **line: Any) -> None:
    """The curve with its 95 % band. `line`: the curve alone."""
    axes.fill_between(time, middle - WIDE * sd, middle + WIDE * sd, color=colour, alpha=0.25, lw=0.0)
    axes.plot(time, middle, color=colour, **line)


def _component(axes: Axes, found: Sensed, c: int, name: str, colour: str) -> None:
    middle, sd = found.force[:, c], np.sqrt(found.covariance[:, c, c])
    weak = found.prior_share[:, c] > _FROM_PRIOR
    if weak.any():
        across, shaded = axes.get_xaxis_transform(), "not observable: prior"
        axes.fill_between(
            found.time, 0.0, 1.0, where=weak, transform=across, label=shaded, color=FAINT, alpha=0.7, lw=0.0
        )
    _band(axes, found.time, middle, sd, colour, label="from the shape")
    axes.plot(found.time, found.logged[:, c], "--", color=INK, lw=1.0, label="log")
    axes.set_ylabel(f"force along {name} [N]")
    size = np.linalg.norm(found.force[found.touched], axis=1)
    if size.size and np.isfinite(size).any():
        most = _BEYOND * float(np.nanmax(size))
        axes.set_ylim(-most, most)
