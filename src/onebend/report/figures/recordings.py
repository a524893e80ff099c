"""The figures of a report, one function a figure. Lengths are shown in mm, forces in N, stiffness in N m."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from onebend.beam.model import Beam
from onebend.escaping import figure_text
from onebend.learning.model.frames import distances
from onebend.learning.outcome import Comparison, Explained, Learned, Trial
from onebend.recording.camera.lens import project
from onebend.recording.signals import runs
from onebend.records import Array, Observations, View
from onebend.report.figures.simulated import centreline, push_to_show, same_frame, spread_of_pushes
from onebend.report.figures.style import BLUE, GREEN, INK, MUTED, ORANGE, blank, colour, named, shape, styled
from onebend.report.wording import millimetres, significant

MM = 1000.0
_A_ROW = 5  # markers whose names fit side by side
_DASHED: dict[str, Any] = {"linestyle": (0, (4, 3))}
# What is drawn over a photo keeps a white edge, to be seen on any background.
_EDGED: dict[str, Any] = {"path_effects": [withStroke(linewidth=4.4, foreground="white")]}


@styled
def fit_over_frame(
    image: NDArray[np.uint8],
    view: View,
    beam: Beam,
    comparison: Comparison,
    observations: Observations,
    fitted: Explained | None = None,
) -> Figure:
    """Measured tags and the beam at the largest push (to a percent), over the video frame (RGB) itself.

    The beam is the one that the fit found, where there is a fit; dashed beside it, or else alone: simulated under the
    force as logged.
    """
    shown = comparison if fitted is None else fitted.comparison
    t = push_to_show(shown)
    logged = centreline(beam, comparison, observations, t if fitted is None else same_frame(comparison, shown, t))
    line = logged if fitted is None else fitted.line[t]
    what = "simulated" if fitted is None else "fitted"
    figure, (axes,) = blank(4.4)
    axes.imshow(image)
    axes.set_axis_off()
    points = [project(view, shown.measured[t])]
    if fitted is not None and logged is not None:
        points += [project(view, logged)]
        axes.plot(*points[-1].T, color=INK, linewidth=1.2, **_DASHED, label="under the force as logged",
                  path_effects=[withStroke(linewidth=2.6, foreground="white")])  # fmt: skip
    if line is not None:
        points += [project(view, line)]
        axes.plot(*points[-1].T, color=BLUE, linewidth=2.2, label=f"{what} beam", **_EDGED)
        predicted = project(view, shown.predicted[t])
        axes.plot(*predicted.T, "+", color=BLUE, markersize=11, markeredgewidth=2, label=f"{what} tags", **_EDGED)
    axes.plot(*points[0].T, "o", markerfacecolor="none", markeredgecolor=ORANGE, markersize=10, markeredgewidth=2,
              label="measured tags", **_EDGED)  # fmt: skip
    where = line[round(float(shown.push_s[t]) * (len(line) - 1))] if line is not None else shown.measured[t, -1]
    points += [_draw_force(axes, view, where, shown.force[t], 0.22 * beam.length)]
    _crop(axes, np.concatenate(points), image.shape)
    size = f"{significant(float(np.linalg.norm(shown.force[t])))} N" + (" as fitted," if fitted is not None else "")
    axes.set_title(f"{figure_text(comparison.name)}, frame {shown.frame[t]}: {size} at s = {shown.push_s[t]:.2g}")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=4 if fitted is not None else 3, columnspacing=1.2)
    return figure


def _draw_force(axes: Axes, view: View, tip: Array, force: Array, length_m: float) -> Array:
    """An arrow that ends where the force acts; returns its two ends [px]."""
    size = float(np.linalg.norm(force))
    if size == 0.0:
        return np.asarray(project(view, tip[None]))
    ends = np.asarray(project(view, np.stack([tip - force / size * length_m, tip])))
    arrow = {"arrowstyle": "-|>", "color": ORANGE, "linewidth": 2.2, **_EDGED}
    axes.annotate("F", ends[1], ends[0], arrowprops=arrow, color=ORANGE, weight="bold", size=12, **_EDGED)
    return ends


def _crop(axes: Axes, points: Array, size: tuple[int, ...]) -> None:
    """Show what holds all `points` [px] with room around, at least as wide as the page's figures are."""
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    extent = high - low + 0.24 * float(np.max(high - low)) + 40.0
    extent[0] = max(extent[0], 1.6 * extent[1])
    limits = np.array([size[1], size[0]], dtype=float)
    extent = np.minimum(extent, limits)
    corner = np.clip((low + high - extent) / 2, 0.0, limits - extent) - 0.5
    axes.set_xlim(corner[0], corner[0] + extent[0])
    axes.set_ylim(corner[1] + extent[1], corner[1])


@styled
def shapes(beam: Beam, comparison: Comparison, observations: Observations, fitted: Explained | None = None) -> Figure:
    """The beam and the measured tags at rest and at pushes of growing size (Fig. 7 of the paper)."""
    figure, (axes,) = blank(3.6)
    shown, count = comparison if fitted is None else fitted.comparison, len(comparison.tag_id)
    chosen = spread_of_pushes(shown, 6)
    for order, t in enumerate(chosen):
        strength = 0.25 + 0.75 * (order + 1) / len(chosen)
        logged = None
        if fitted is None or not comparison.static:
            at = t if fitted is None else same_frame(comparison, shown, t)
            logged = centreline(beam, comparison, observations, at)
        if fitted is not None and logged is not None:
            axes.plot(*(MM * logged.T), color=MUTED, alpha=strength, linewidth=1.0, **_DASHED)
        line = logged if fitted is None else fitted.line[t]
        if line is not None:
            axes.plot(*(MM * line.T), color=BLUE, alpha=strength, linewidth=1.6)
        for i in range(count):
            axes.plot(
                *(MM * shown.measured[t, i]), shape(i), color=colour(i, count), alpha=strength, markersize=6, zorder=4,
                label=f"tag {shown.tag_id[i]} measured" if order == len(chosen) - 1 and i in named(count) else None,
            )  # fmt: skip
    axes.plot([], [], color=BLUE, label="simulated beam" if fitted is None else "fitted beam")
    if fitted is not None and not comparison.static:
        axes.plot([], [], color=MUTED, linewidth=1.0, **_DASHED, label="under the force\nas logged")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.set_title(f"{figure_text(comparison.name)}: shapes under growing {'load' if comparison.static else 'force'}")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


@styled
def markers(comparison: Comparison, fitted: Explained | None = None) -> Figure:
    """Every tag over time in x and y: measured (dots), and fitted or simulated under the force as logged (lines)."""
    figure, (above, below) = blank(4.6, 2, 1, sharex=True)
    time, shown = comparison.time - comparison.time[0], comparison if fitted is None else fitted.comparison
    step, count = max(1, len(time) // 150), len(comparison.tag_id)  # dots that would cover each other are left out
    for axes, axis, name in ((above, 0, "x"), (below, 1, "y")):
        for i in range(count):
            tint = colour(i, count)
            axes.plot(time[::step], MM * comparison.measured[::step, i, axis], shape(i), color=tint, alpha=0.45,
                      markersize=3.2, markeredgewidth=0)  # fmt: skip
            if fitted is not None and not comparison.static:
                axes.plot(*_unbroken(time, MM * comparison.predicted[:, i, axis]), color=tint, linewidth=0.9, **_DASHED)
            curve = _unbroken(shown.time - comparison.time[0], MM * shown.predicted[:, i, axis])
            label = f"tag {comparison.tag_id[i]}, s = {comparison.marker_s[i]:.3g}" if i in named(count) else None
            axes.plot(*curve, color=tint, linewidth=1.4, label=label, **_marked(i, time))
        axes.set_ylabel(f"{name} [mm]")
    below.set_xlabel(_time_label(comparison))
    lines = "lines simulated" if fitted is None else "lines fitted"
    if fitted is not None and not comparison.static:
        lines += ", dashed under the force as logged"
    above.set_title(f"{figure_text(comparison.name)}: dots measured, {lines}")
    if count <= _A_ROW:
        above.legend(loc="lower center", bbox_to_anchor=(0.5, -0.19), ncols=max(3, count))
    else:
        above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=_A_ROW - 1)
    return figure


def _unbroken(time: Array, values: Array) -> tuple[Array, Array]:
    """A line that is not drawn across gaps in time (frames that were not simulated)."""
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1 if len(time) > 2 else np.array([], dtype=int)
    return np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan)


def _marked(i: int, time: Array) -> dict[str, Any]:
    """The i-th tag's symbol now and then on its line, which its colour alone would not tell from the others."""
    return {"marker": shape(i), "markevery": max(1, len(time) // 9), "markersize": 4.5}


def _time_label(comparison: Comparison) -> str:
    return "pose" if comparison.static else "time since the first loaded frame [s]"


@styled
def residuals(comparison: Comparison, title: str = "measured to simulated") -> Figure:
    """How far simulated tags are from the measured ones: over time, and in the plane where x and y were measured."""
    residual = MM * (comparison.measured - comparison.predicted)
    both = bool(np.any(np.isfinite(residual).all(axis=-1)))  # a plane needs x and y of the same tag
    figure, panels = blank(3.2, 1, 2, width_ratios=(1.7, 1.0)) if both else blank(3.2)
    left = panels[0]
    time, count = comparison.time - comparison.time[0], len(comparison.tag_id)
    for i, rms in enumerate(comparison.rms):
        distance, tint = distances(residual[:, i]), colour(i, count)
        label = f"tag {comparison.tag_id[i]}: {millimetres(rms)} RMS" if i in named(count) else None
        left.plot(*_unbroken(time, distance), color=tint, linewidth=1.1, label=label, **_marked(i, time))
        if both:
            panels[1].plot(*residual[:, i].T, shape(i), color=tint, markersize=2.6, alpha=0.5, markeredgewidth=0)
    left.set(xlabel=_time_label(comparison), ylabel="distance [mm]", ylim=(0, None))
    left.set_title(f"{figure_text(comparison.name)}: {title}")
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=max(2, min(3, count)), fontsize=8)
    for plane in panels[1:]:
        plane.axhline(0, color=MUTED, linewidth=0.8)
        plane.axvline(0, color=MUTED, linewidth=0.8)
        plane.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
        plane.set_title("in the plane")
    return figure


@styled
def selection(learned: Learned) -> Figure:
    """The (n, m) table as a map of the BIC; the chosen pair framed, pairs out of the running left grey."""
    trials = learned.trials
    ns, ms = sorted({trial.n for trial in trials}), sorted({trial.m for trial in trials})
    figure, (axes,) = blank(0.42 * len(ns) + 1.3)
    running = [trial.bic for trial in trials if np.isfinite(trial.bic)]
    low = min(running, default=0.0)
    scale = Normalize(0.0, max(max(running, default=1.0) - low, 1e-9))
    colours = LinearSegmentedColormap.from_list("quiet", ["#2c7fb8", "#bfdcec", "#f5f7fa"])
    axes.grid(visible=False)
    for i, trial in enumerate(trials):
        x, y = ms.index(trial.m), ns.index(trial.n)
        above = trial.bic - low
        inside = bool(np.isfinite(trial.bic))
        face = colours(scale(above)) if inside else "#eceef1"
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1, 1, facecolor=face, edgecolor="white", linewidth=2))
        dark = inside and float(np.dot(face[:3], (0.299, 0.587, 0.114))) < 0.55
        axes.text(x, y, _cell(trial), ha="center", va="center", color="white" if dark else INK, fontsize=8.5)
        if i == learned.chosen:
            box = Rectangle((x - 0.47, y - 0.44), 0.94, 0.88, fill=False, edgecolor=ORANGE, linewidth=2.4, zorder=5)
            axes.add_patch(box)
    axes.set(xlim=(-0.5, len(ms) - 0.5), ylim=(len(ns) - 0.5, -0.5))
    axes.set_xticks(range(len(ms)), [str(m) for m in ms])
    axes.set_yticks(range(len(ns)), [str(n) for n in ns])
    axes.set(xlabel="stiffness functions m", ylabel="curvature modes n")
    axes.set_title("BIC (lower is better; framed: chosen; grey: out of the running)")
    return figure


def _cell(trial: Trial) -> str:
    return f"{trial.bic:.0f}" if np.isfinite(trial.bic) else "out"


@styled
def force(observations: Observations, fitted: Explained | None = None) -> Figure:
    """The force on the beam over time: what was filmed, when contact was, what was taken off; the fit's own dashed."""
    clean = observations.source.clean_force
    figure, (axes,) = blank(3.0)
    time, values = (observations.time, observations.force) if clean is None else (clean.time, clean.force)
    start = float(observations.time[0])
    step = max(1, len(time) // 4000)
    for axis, (name, tint) in enumerate((("x", GREEN), ("y", BLUE))):
        label = f"F{name}"
        if clean is not None:
            label += f"  (tare {clean.tare[axis]:+.3f} N taken off, noise left {MM * clean.noise_sd[axis]:.1f} mN)"
        axes.plot(time[::step] - start, values[::step, axis], color=tint, linewidth=1.2, label=label)
        if fitted is not None:
            there = fitted.comparison
            axes.plot(*_unbroken(there.time - start, there.force[:, axis]), color=tint, linewidth=1.2,
                      **_DASHED, alpha=0.9, label=f"F{name} as fitted")  # fmt: skip
    axes.axhline(0, color=MUTED, linewidth=0.8)
    for first, last in _spans(observations.time - start, observations.loaded):
        axes.axvspan(first, last, color=ORANGE, alpha=0.08, linewidth=0)
    axes.axvline(0.0, color=MUTED, linestyle=":", linewidth=1)
    axes.axvline(float(observations.time[-1]) - start, color=MUTED, linestyle=":", linewidth=1)
    axes.set(xlabel="time since the first frame [s]", ylabel="force [N]")
    axes.set_title("force on the beam (shaded: in contact; dotted: first and last frame)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=1 if fitted is None else 2)
    return figure


def _spans(time: Array, flags: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """First and last time of every run of True."""
    return [(float(time[first]), float(time[end - 1])) for first, end in runs(flags)]


@styled
def validation(comparisons: Sequence[Comparison]) -> Figure:
    """RMS per tag and recording (Tables IV to VI), and the force noise."""
    figure, (axes,) = blank(0.9 + 0.28 * sum(len(comparison.tag_id) + 1 for comparison in comparisons))
    y, ticks = 0.0, []
    for comparison in comparisons:
        for i, rms in enumerate(MM * comparison.rms):
            axes.barh(y, rms, height=0.8, color=colour(i, len(comparison.rms)), alpha=0.85)
            axes.plot(MM * comparison.sensor_rms[i], y, "|", color=INK, markersize=11, markeredgewidth=1.8)
            end = np.nanmax([rms, MM * comparison.sensor_rms[i], 0.0])
            text = f"{millimetres(comparison.rms[i])} ({millimetres(comparison.sensor_rms[i])})"
            axes.annotate(text, (end, y), (6, 0), textcoords="offset points", va="center", fontsize=8.5)
            tag = f"tag {comparison.tag_id[i]}"
            ticks.append((y, f"{figure_text(comparison.name)}  {tag}" if i == 0 else tag))
            y += 1.0
        y += 0.7
    axes.set_yticks(*zip(*ticks, strict=True))
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.margins(x=0.1)
    axes.set(xlabel="RMS distance, measured to simulated [mm]\n(| and in brackets: force noise)")
    return figure
