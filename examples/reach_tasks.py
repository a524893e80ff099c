"""Fig. 8 of the paper: the tip and a point in the middle of three beams led to goals, as docs/images/reach-*.png."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from onebend import Beam, reach
from onebend.beam import Table
from onebend.control import Reach, ReachableSet, reachable
from onebend.report.control_figures import MM, draw_reach, draw_reachable
from onebend.report.style import MUTED, blank, plane, png_of, styled

PLACES = tuple(np.linspace(0.0, 1.0, 11).tolist())
# k(s) [N m] of beams like the paper's: weakest at the base, in the middle, near the tip.
BEAMS = {
    "linear": Beam(0.15, Table(PLACES, tuple((0.012 + 0.018 * np.array(PLACES)).tolist()))),
    "quadratic": Beam(0.15, Table(PLACES, tuple((0.012 + 0.06 * (np.array(PLACES) - 0.5) ** 2).tolist()))),
    "cubic": Beam(0.15, Table(PLACES, tuple((0.022 + 0.06 * (0.6 - np.array(PLACES)) ** 3).tolist()))),
}
TASKS = {"tip": (1.0, (0.115, 0.0905)), "middle": (0.6, (0.0822, 0.0345))}  # place of point and force, goal [m]


def solve() -> dict[tuple[str, str], Reach]:
    """All six tasks."""
    return {
        (name, task): reach(beam, goal, push_s=place, point_s=place)
        for task, (place, goal) in TASKS.items()
        for name, beam in BEAMS.items()
    }


@styled
def draw_tasks(found: dict[tuple[str, str], Reach]) -> Figure:
    """A column a beam."""
    figure, axes = blank(4.2, 2, 3)
    for one, (name, task), each in zip(axes, found, found.values(), strict=True):
        draw_reach(one, each, None)
        one.set_title(f"{name}, {task}: {np.hypot(*each.force):.2f} N")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    return figure


@styled
def draw_places(within: ReachableSet) -> Figure:
    """All places of the point, by the force that holds it there."""
    figure, (axes,) = blank(4.2)
    draw_reachable(axes, within)
    rest = within.pushed.beam.equilibrium((0.0, 0.0)).xy(np.linspace(0.0, 1.0, 121))
    axes.plot(*(MM * rest.T), color=MUTED, label="at rest")
    plane(axes, f"What forces at s = {within.pushed.push_s:.3g} can do with the point s = {within.pushed.point_s:.3g}")
    axes.legend(loc="center left", bbox_to_anchor=(0.3, 0.62))
    return figure


def main(out: Path) -> list[Path]:
    """Write the figures into a folder; returns their paths."""
    out.mkdir(parents=True, exist_ok=True)
    drawings = {
        "reach-tasks.png": draw_tasks(solve()),
        "reach-places.png": draw_places(reachable(BEAMS["linear"], max_force=0.6)),
    }
    for name, figure in drawings.items():
        (out / name).write_bytes(png_of(figure))
    return [out / name for name in drawings]


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs" / "images"
    for path in main(folder):
        print(path)
