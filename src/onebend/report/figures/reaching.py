"""The picture of a reached goal (Fig. 8 of the paper), and of all that can be reached."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from onebend.control.reach.reach import Reach
from onebend.control.reach.reachable import ReachableSet
from onebend.control.reach.uncertainty import SURE, PredictedError
from onebend.records import Array
from onebend.report.figures.style import BLUE, GREEN, INK, MUTED, ORANGE, blank, plane, styled
from onebend.report.wording import significant

MM = 1000.0
SNAPSHOTS = 6
ARROW = 0.22  # of L, of the largest force
TORN = 0.25  # of L: the neighbours of a sample that lie further apart belong to two sheets


@styled
def reaching(result: Reach, error: PredictedError | None = None, within: ReachableSet | None = None) -> Figure:
    """The beam at rest and on its way to the goal, the force at its end, and how sure the reached point is."""
    figure, (axes,) = blank(4.2)
    if within is not None:
        draw_reachable(axes, within)
    draw_reach(axes, result, error)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


@styled
def reachable_places(within: ReachableSet) -> Figure:
    """All places of the point, by the force that holds it there."""
    figure, (axes,) = blank(4.2)
    draw_reachable(axes, within)
    s = np.linspace(0.0, 1.0, 121)
    rest = within.pushed.shape_xy(within.pushed.start.q, s)
    axes.plot(*(MM * rest.T), color=MUTED, label="at rest")
    plane(axes, f"What forces at s = {within.pushed.push_s:.3g} can do with the point s = {within.pushed.point_s:.3g}")
    axes.legend(loc="center left", bbox_to_anchor=(0.3, 0.62))
    return figure


def draw_reach(axes: Axes, result: Reach, error: PredictedError | None) -> None:
    """Snapshots, goal, point, force and ellipse."""
    s = np.linspace(0.0, 1.0, 121)
    shapes = result.shapes(s)
    chosen = np.unique(np.round(np.linspace(0, len(shapes) - 1, SNAPSHOTS)).astype(int))
    for i in chosen:
        last, rest = i == chosen[-1], i == 0
        label = "under the force" if last else "at rest" if rest else "on the way" if i == chosen[1] else None
        colour = MUTED if rest else BLUE
        strength = 1.0 if last or rest else 0.2 + 0.4 * i / max(chosen[-1], 1)
        axes.plot(*(MM * shapes[i].T), color=colour, alpha=strength, lw=2.4 if last else 1.3, label=label)
    axes.plot(*(MM * result.path_points.T), ":", color=INK, lw=1.0, label="the point's way")
    axes.plot(*(MM * result.goal[:2]), "x", color=ORANGE, markersize=11, markeredgewidth=2.2, zorder=6, label="goal")
    axes.plot(*(MM * result.reached[:2]), "o", color=BLUE, markersize=5.5, zorder=5)
    _arrow(axes, result, MM * result.shapes(np.array([result.push_s]))[-1, 0])
    if error is not None:
        outline = MM * (error.mean + error.ellipse(SURE).outline())
        axes.plot(*outline.T, color=GREEN, lw=1.6, zorder=8, label=f"{100 * SURE:.0f} % by the band on k(s)")
    plane(axes, f"{significant(float(np.hypot(*result.force)))} N at s = {result.push_s:.3g}: {_outcome(result)}")


def _outcome(result: Reach) -> str:
    where = f"the point s = {result.point_s:.3g}"
    return f"{where} is on its goal" if result.converged else f"{where} is {MM * result.error:.3g} mm from its goal"


def _arrow(axes: Axes, result: Reach, at: Array) -> None:
    size = float(np.hypot(*result.force))
    if size == 0.0:
        return
    head = at + MM * ARROW * result.beam.length * result.force / size
    axes.annotate("", tuple(head), tuple(at), arrowprops={"arrowstyle": "-|>", "color": ORANGE, "lw": 1.8}, zorder=7)
    axes.plot(*head, alpha=0.0)  # so that the arrow is inside the picture
    axes.plot([], [], color=ORANGE, label="force")


def draw_reachable(axes: Axes, within: ReachableSet) -> None:
    """Cells between the samples, darker where more force is needed; none where the beam would jump."""
    rest = np.broadcast_to(within.pushed.pose(within.pushed.start.q)[:2], (len(within.points), 1, 2))
    rings = np.concatenate([rest, within.points], axis=1)
    around = np.concatenate([rings, rings[:1]])
    cells = np.stack([around[:-1, :-1], around[1:, :-1], around[1:, 1:], around[:-1, 1:]], axis=2)
    sides = np.linalg.norm(cells - np.roll(cells, 1, axis=2), axis=-1).max(axis=-1)
    size = np.broadcast_to(np.linalg.norm(within.force, axis=-1), sides.shape)
    whole = sides < TORN * float(within.pushed.problem.length)  # NaN is none
    mesh = PolyCollection(
        list(MM * cells[whole]), array=size[whole], cmap="Blues", alpha=0.55, edgecolors="face", linewidths=0.3
    )
    mesh.set_clim(0.0, 1.25 * within.max_force)
    axes.add_collection(mesh)
    axes.autoscale_view()
    bar = axes.figure.colorbar(mesh, ax=axes, shrink=0.6, pad=0.01, location="left")
    bar.set_label("force that holds the point there [N]")
    bar.ax.set_ylim(0.0, within.max_force)
