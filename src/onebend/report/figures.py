"""Pictures of learning, one function per figure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from onebend.beam.model import Beam
from onebend.beam.stiffness import Band, Profile, UncertainStiffness
from onebend.errors import MechanicsError, OnebendError
from onebend.learning.frames import distances
from onebend.learning.outcome import Comparison, Explained
from onebend.learning.run import Run
from onebend.learning.validation import solved_frames
from onebend.learning.verdict import explained
from onebend.progress import Progress, Silent
from onebend.recording.entries import Recording
from onebend.recording.photos import read_photo
from onebend.recording.plane import project
from onebend.recording.preview import Preview, bent
from onebend.recording.signals import runs
from onebend.recording.video import KeptFrames, roundest
from onebend.records import POINT_ID, Array, BoolArray, ForceLog, Observations, View, tags_among
from onebend.report.overview import SOFTWARE, Overview, tared
from onebend.report.pictures import Draw, Pictures, draw, film_of, film_strip, reason_of
from onebend.report.sentences import (
    LEVELS,
    axis_words,
    highest_shown,
    legend_words,
    millimetres,
    only_frequencies,
    significant,
    tag_words,
    words_of,
)
from onebend.report.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    PINK,
    blank,
    hue_of,
    named,
    png_of,
    shape,
    styled,
)
from onebend.text_files import figure_text

MM = 1000.0
GREY = "#98a2b3"
_S = np.linspace(0.0, 1.0, 401)


@styled
def stiffness(
    beam: Beam,
    *,
    uncertain: UncertainStiffness | None = None,
    regression: Profile | None = None,
    tags: Mapping[int, float] = MappingProxyType({}),
    push_s: float | None = None,
) -> Figure:
    """k(s) with its bands, grey where not identified, and the regression. Symbols: tags; hatched: never loaded."""
    if uncertain is None:
        figure, (axes,) = blank(3.1)
        low, top = _plain(axes, beam.stiffness(_S))
    else:
        figure, (axes, relative) = blank(4.9, 2, 1, sharex=True, height_ratios=(2.6, 1.0))
        low, top = 0.0, _banded(axes, uncertain)
        _relative(relative, uncertain, regression)
    if regression is not None:
        axes.plot(_S, regression(_S), color=ORANGE, linewidth=1.3, linestyle="--", label="the paper's regression")
        top = max(top, min(float(np.max(regression(_S))), 1.5 * top))
    axes.set(xlim=(0, 1), ylabel="bending stiffness k = EI / L [N m]", ylim=(1.15 * low, 1.15 * top or None))
    _places(axes, tags, push_s)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")
    figure.axes[-1].set_xlabel("place along the beam s")
    length = MM * beam.length
    above = axes.secondary_xaxis("top", functions=(partial(np.multiply, length), partial(np.multiply, 1.0 / length)))
    above.set_xlabel("distance from the clamp [mm]", color=MUTED)
    return figure


def _plain(axes: Axes, k: Array) -> tuple[float, float]:
    axes.plot(_S, k, color=BLUE)
    axes.fill_between(_S, 0.0, k, color=BLUE, alpha=0.08, linewidth=0)
    if k.min() <= 0.0:
        axes.fill_between(_S, 0.0, k, where=k <= 0.0, color=ORANGE, alpha=0.35, label="not positive: no beam")
    return min(0.0, float(k.min())), max(float(k.max()), 0.0)


def _banded(axes: Axes, uncertain: UncertainStiffness) -> float:
    wide = _bands(axes, uncertain, np.asarray)
    known, k = wide.identified, wide.k
    axes.plot(_S, np.where(known, k, np.nan), color=BLUE, label="k(s)")
    axes.fill_between([], [], color=BLUE, alpha=0.5, linewidth=0, label="50, 80, 95 % band")  # for the legend
    if not known.all():
        axes.plot(_S, np.where(_reach(~known), k, np.nan), color=GREY)
        why = "not to be trusted" if uncertain.doubts else "not identified"
        axes.fill_between([], [], color=GREY, alpha=0.6, linewidth=0, label=why)
    return highest_shown(uncertain)


def _relative(axes: Axes, uncertain: UncertainStiffness, regression: Profile | None) -> None:
    k = uncertain.profile(_S)
    wide = _bands(axes, uncertain, lambda value: 100.0 * (value / k - 1.0))
    axes.plot(_S, np.where(wide.identified, 0.0, np.nan), color=BLUE)
    axes.plot(_S, np.where(_reach(~wide.identified), 0.0, np.nan), color=GREY)
    if regression is not None:
        axes.plot(_S, 100.0 * (regression(_S) / k - 1.0), color=ORANGE, linewidth=1.3, linestyle="--")
    reach = 120.0 * float(np.max((wide.high / k - 1.0)[uncertain.best_known(_S)]))
    axes.set(ylim=(-min(reach, 100.0), reach), ylabel="against k [%]")


def _bands(axes: Axes, uncertain: UncertainStiffness, shown: Callable[[Array], Array]) -> Band:
    """Draws the bands, grey where not identified; returns the widest."""
    for level, strength in LEVELS:
        band = uncertain.band(_S, level)
        for where, tint in ((band.identified, BLUE), (~band.identified, GREY)):
            axes.fill_between(
                _S, shown(band.low), shown(band.high), where=_reach(where), color=tint, alpha=strength, linewidth=0
            )  # fmt: skip
    return uncertain.band(_S, LEVELS[0][0])


def _reach(where: BoolArray) -> BoolArray:
    """Flags extended by one place, so that neighbouring pieces touch."""
    return np.concatenate([where[:1], where[1:] | where[:-1]])


def _places(axes: Axes, tags: Mapping[int, float], push_s: float | None) -> None:
    count, words = len(tags), axis_words(list(tags)) if tags else []
    worded = [i for i, text in enumerate(words) if text]
    shown = {worded[i] for i in named(len(worded))}
    for i, (text, place) in enumerate(zip(words, tags.values(), strict=True)):
        tint = hue_of(i, count)
        axes.plot(place, 0.0, marker=shape(i), color=tint, markersize=7, clip_on=False, zorder=5)
        if i in shown:
            axes.annotate(text, (place, 0.0), (0, 7), textcoords="offset points", ha="center", color=tint, fontsize=8.5)
    if push_s is not None and push_s < 0.999:
        axes.axvspan(push_s, 1.0, facecolor="none", edgecolor=FAINT, hatch="///", linewidth=0)
        axes.annotate("never loaded", ((1 + push_s) / 2, 0.5), xycoords=("data", "axes fraction"), ha="center")


LARGE = 0.99  # of the largest force: equivalent for display


def largest_push(comparison: Comparison) -> int:
    """Frame with the largest force among those with most markers."""
    return int(np.argmax(_sizes(comparison)))


def push_to_show(comparison: Comparison) -> int:
    """An equivalent frame that is likely to be kept."""
    size = _sizes(comparison)
    large = np.flatnonzero(size >= min(LARGE * size.max(), size.max()))
    return int(large[roundest(comparison.frame[large])])


def _sizes(comparison: Comparison) -> Array:
    """(T,) N; -1 for frames with fewer markers."""
    seen = np.isfinite(comparison.measured[..., 0]).sum(axis=1)
    size = np.linalg.norm(comparison.force, axis=1)
    return np.asarray(np.where((seen == seen.max()) & np.isfinite(size), size, -1.0))


def spread_of_pushes(comparison: Comparison, count: int) -> list[int]:
    """Frames with about 0, 1/(count-1), ..., 1 times the largest force."""
    size = np.nan_to_num(np.linalg.norm(comparison.force, axis=1))
    last = largest_push(comparison)
    rising = size[: last + 1]
    wanted = np.linspace(0.0, size[last], count)
    return sorted({int(np.argmin(np.abs(rising - value))) for value in wanted})


def centreline(
    beam: Beam, comparison: Comparison, observations: Observations, t: int, places: int = 121
) -> Array | None:
    """(places, 2) m, simulated under the loads of frame t; None if that fails."""
    here: BoolArray = np.asarray(observations.frame == comparison.frame[t])
    if not np.any(here):
        return None
    try:
        solved = next(solved_frames(beam, observations, here))
    except MechanicsError:
        return None
    return solved.xy(np.linspace(0.0, 1.0, places))[0] if solved.converged[0] else None


@dataclass(frozen=True)
class Shown:
    """A recording with the beam: simulated under the force as logged, and perhaps fitted."""

    beam: Beam
    logged: Comparison
    observations: Observations
    fitted: Explained | None = None

    @property
    def best(self) -> Comparison:
        return self.logged if self.fitted is None else self.fitted.comparison

    @property
    def both(self) -> bool:
        """Whether the beam under the force as logged is another one: static poses have the loads that hang there."""
        return self.fitted is not None and not self.logged.static

    def lines(self, t: int) -> tuple[Array | None, Array | None]:
        """(121, 2) m of frame t of `best`: the beam under the logged force, None if that fails, and the best one."""
        at = int(np.argmin(np.abs(self.logged.time - self.best.time[t])))
        logged = centreline(self.beam, self.logged, self.observations, at)
        return logged, logged if self.fitted is None else self.fitted.line[t]


# Lengths in mm, forces in N, stiffness in N m.

_A_ROW = 5  # legend columns
_DASHED: dict[str, Any] = {"linestyle": (0, (4, 3))}
# A white edge is visible on any photo.
_EDGED_WIDE: dict[str, Any] = {"path_effects": [withStroke(linewidth=4.4, foreground="white")]}


@styled
def fit_over_frame(image: NDArray[np.uint8], view: View, one: Shown) -> Figure:
    """Tags and fitted beam over the RGB frame of the largest push; dashed: under the logged force."""
    shown, fitted = one.best, one.fitted
    t = push_to_show(shown)
    logged, line = one.lines(t)
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
        axes.plot(*points[-1].T, color=BLUE, linewidth=2.2, label=f"{what} beam", **_EDGED_WIDE)
        predicted = project(view, shown.predicted[t])
        axes.plot(*predicted.T, "+", color=BLUE, markersize=11, markeredgewidth=2, label=f"{what} tags", **_EDGED_WIDE)
    axes.plot(*points[0].T, "o", markerfacecolor="none", markeredgecolor=ORANGE, markersize=10, markeredgewidth=2,
              label="measured tags", **_EDGED_WIDE)  # fmt: skip
    where = line[round(float(shown.push_s[t]) * (len(line) - 1))] if line is not None else shown.measured[t, -1]
    points += [_draw_force(axes, view, where, shown.force[t], 0.22 * one.beam.length)]
    _crop(axes, np.concatenate(points), image.shape)
    size = f"{significant(float(np.linalg.norm(shown.force[t])))} N" + (" as fitted," if fitted is not None else "")
    axes.set_title(f"{figure_text(shown.name)}, frame {shown.frame[t]}: {size} at s = {shown.push_s[t]:.2g}")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=4 if fitted is not None else 3, columnspacing=1.2)
    return figure


def _draw_force(axes: Axes, view: View, tip: Array, force: Array, length_m: float) -> Array:
    """An arrow to the place of the force; returns its ends [px]."""
    size = float(np.linalg.norm(force))
    if size == 0.0:
        return np.asarray(project(view, tip[None]))
    ends = np.asarray(project(view, np.stack([tip - force / size * length_m, tip])))
    arrow = {"arrowstyle": "-|>", "color": ORANGE, "linewidth": 2.2, **_EDGED_WIDE}
    axes.annotate("F", ends[1], ends[0], arrowprops=arrow, color=ORANGE, weight="bold", size=12, **_EDGED_WIDE)
    return ends


def _crop(axes: Axes, points: Array, size: tuple[int, ...]) -> None:
    """Shows all `points` [px] with a margin, at least as wide as the page's figures."""
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
def shapes(one: Shown) -> Figure:
    """Beam and tags under growing force (Fig. 7)."""
    figure, (axes,) = blank(3.6)
    shown, count = one.best, len(one.best.tag_id)
    chosen = spread_of_pushes(shown, 6)
    for order, t in enumerate(chosen):
        strength = 0.25 + 0.75 * (order + 1) / len(chosen)
        logged, line = one.lines(t)
        if one.both and logged is not None:
            axes.plot(*(MM * logged.T), color=MUTED, alpha=strength, linewidth=1.0, **_DASHED)
        if line is not None:
            axes.plot(*(MM * line.T), color=BLUE, alpha=strength, linewidth=1.6)
        for i in range(count):
            axes.plot(
                *(MM * shown.measured[t, i]), shape(i), color=hue_of(i, count), alpha=strength, markersize=6, zorder=4,
                label=f"{legend_words(shown, i)} measured" if order == len(chosen) - 1 and i in named(count) else None,
            )  # fmt: skip
    axes.plot([], [], color=BLUE, label="simulated beam" if one.fitted is None else "fitted beam")
    if one.both:
        axes.plot([], [], color=MUTED, linewidth=1.0, **_DASHED, label="under the force\nas logged")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.set_title(f"{figure_text(shown.name)}: shapes under growing {'load' if shown.static else 'force'}")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


@styled
def markers(one: Shown) -> Figure:
    """Tags in time: measured (dots), fitted or simulated under the force as logged (lines)."""
    figure, (above, below) = blank(4.6, 2, 1, sharex=True)
    comparison, shown = one.logged, one.best
    time = comparison.time - comparison.time[0]
    step, count = max(1, len(time) // 150), len(comparison.tag_id)  # without dots that would overlap
    for axes, axis, name in ((above, 0, "x"), (below, 1, "y")):
        for i in range(count):
            tint = hue_of(i, count)
            axes.plot(time[::step], MM * comparison.measured[::step, i, axis], shape(i), color=tint, alpha=0.45,
                      markersize=3.2, markeredgewidth=0)  # fmt: skip
            if one.both:
                axes.plot(*_unbroken(time, MM * comparison.predicted[:, i, axis]), color=tint, linewidth=0.9, **_DASHED)
            curve = _unbroken(shown.time - comparison.time[0], MM * shown.predicted[:, i, axis])
            label = legend_words(comparison, i, place=True) if i in named(count) else None
            axes.plot(*curve, color=tint, linewidth=1.4, label=label, **_marked(i, time))
        axes.set_ylabel(f"{name} [mm]")
    below.set_xlabel(_time_label(comparison))
    lines = "lines simulated" if one.fitted is None else "lines fitted"
    if one.both:
        lines += ", dashed under the force as logged"
    above.set_title(f"{figure_text(comparison.name)}: dots measured, {lines}")
    if count <= _A_ROW:
        above.legend(loc="lower center", bbox_to_anchor=(0.5, -0.19), ncols=max(3, count))
    else:
        above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=_A_ROW - 1)
    return figure


def _unbroken(time: Array, values: Array) -> tuple[Array, Array]:
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1 if len(time) > 2 else np.array([], dtype=int)
    return np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan)


def _marked(i: int, time: Array) -> dict[str, Any]:
    return {"marker": shape(i), "markevery": max(1, len(time) // 9), "markersize": 4.5}


def _time_label(comparison: Comparison) -> str:
    return "pose" if comparison.static else "time since the first loaded frame [s]"


@styled
def residuals(comparison: Comparison, title: str = "measured to simulated") -> Figure:
    """Distance of simulated from measured tags: over time, and in the plane where both coordinates were measured."""
    residual = MM * (comparison.measured - comparison.predicted)
    both = bool(np.any(np.isfinite(residual).all(axis=-1)))  # a plane needs both coordinates
    figure, panels = blank(3.2, 1, 2, width_ratios=(1.7, 1.0)) if both else blank(3.2)
    left = panels[0]
    time, count = comparison.time - comparison.time[0], len(comparison.tag_id)
    for i, rms in enumerate(comparison.rms):
        distance, tint = distances(residual[:, i]), hue_of(i, count)
        label = f"{tag_words(comparison, i)}: {millimetres(rms)} RMS" if i in named(count) else None
        left.plot(*_unbroken(time, distance), color=tint, linewidth=1.1, label=label, **_marked(i, time))
        if both:
            panels[1].plot(*residual[:, i].T, shape(i), color=tint, markersize=2.6, alpha=0.5, markeredgewidth=0)
    left.set(xlabel=_time_label(comparison), ylabel="distance [mm]", ylim=(0, None))
    left.set_title(f"{figure_text(comparison.name)}: {title}")
    columns = 3 if count > 2 and comparison.tag_id.max() < POINT_ID else 2
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=columns, fontsize=8)
    for plane in panels[1:]:
        plane.axhline(0, color=MUTED, linewidth=0.8)
        plane.axvline(0, color=MUTED, linewidth=0.8)
        plane.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", adjustable="datalim")
        plane.set_title("in the plane")
    return figure


@styled
def force(observations: Observations, fitted: Explained | None = None) -> Figure:
    """Force in time: film, contact, tare; the fit's force dashed."""
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
    for first, end in runs(observations.loaded):
        axes.axvspan(*(observations.time[[first, end - 1]] - start), color=ORANGE, alpha=0.08, linewidth=0)
    axes.axvline(0.0, color=MUTED, linestyle=":", linewidth=1)
    axes.axvline(float(observations.time[-1]) - start, color=MUTED, linestyle=":", linewidth=1)
    axes.set(xlabel="time since the first frame [s]", ylabel="force [N]")
    axes.set_title("force on the beam (shaded: in contact; dotted: first and last frame)")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=1 if fitted is None else 2)
    return figure


@styled
def validation(comparisons: Sequence[Comparison]) -> Figure:
    """RMS per tag and recording (Tables IV to VI), and the force noise."""
    figure, (axes,) = blank(0.9 + 0.28 * sum(len(comparison.tag_id) + 1 for comparison in comparisons))
    y, ticks = 0.0, []
    for comparison in comparisons:
        for i, rms in enumerate(MM * comparison.rms):
            axes.barh(y, rms, height=0.8, color=hue_of(i, len(comparison.rms)), alpha=0.85)
            axes.plot(MM * comparison.sensor_rms[i], y, "|", color=INK, markersize=11, markeredgewidth=1.8)
            end = np.nanmax([rms, MM * comparison.sensor_rms[i], 0.0])
            text = f"{millimetres(comparison.rms[i])} ({millimetres(comparison.sensor_rms[i])})"
            axes.annotate(text, (end, y), (6, 0), textcoords="offset points", va="center", fontsize=8.5)
            tag = tag_words(comparison, i)
            ticks.append((y, f"{figure_text(comparison.name)}  {tag}" if i == 0 else tag))
            y += 1.0
        y += 0.7
    axes.set_yticks(*zip(*ticks, strict=True))
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.margins(x=0.1)
    axes.set(xlabel="RMS distance, measured to simulated [mm]\n(| and in brackets: force noise)")
    return figure


def draw_all(findings: Run, *, frames: KeptFrames | None = None, progress: Progress = Silent()) -> Pictures:
    """All figures in the page's order. Frames missing in `frames` are read."""
    wanted: dict[str, Draw] = {"stiffness": partial(_stiffness, findings)}
    posterior = findings.posterior
    if only_frequencies(findings.recordings):  # no tags
        return draw(wanted, progress)
    fits: Sequence[Explained | None] = [None] * len(findings.trainings) if posterior is None else explained(posterior)
    kept = frames or KeptFrames()
    return _with_film(findings, draw(wanted | _of_recordings(findings, fits, kept), progress), fits[0], kept)


def _of_recordings(findings: Run, fits: Sequence[Explained | None], kept: KeptFrames) -> dict[str, Draw]:
    beam = findings.beam
    rows = zip(findings.trainings, findings.recordings, fits, strict=True)
    every = [Shown(beam, *row) for row in rows]
    wanted: dict[str, Draw] = {"fit": partial(fit, every[0], kept), "shapes": partial(shapes, every[0])}
    if not every[0].logged.static:  # poses have no time
        wanted["markers"] = partial(markers, every[0])
    for i, one in enumerate(every, start=1):
        before = "" if i == 1 else f"learned-{i}-"
        wanted[f"{before}shapes"] = partial(shapes, one)
        if one.fitted is not None:
            wanted[f"{before}fitted"] = partial(residuals, one.best, "residuals of the fit")
        if one.fitted is None or one.both:  # for static poses only the fit's distance counts
            wanted[f"{before}residuals"] = partial(residuals, one.logged, words_of(one.observations).under)
    if not every[0].logged.static:
        wanted["force"] = partial(force, every[0].observations, fits[0])
    pairs = list(zip(findings.validations, findings.validation_observations, strict=True))
    own = [one.logged if one.both else one.best for one in every]
    return wanted | validation_figures(beam, pairs, *own)


def _with_film(findings: Run, pictures: Pictures, fitted: Explained | None, kept: KeptFrames) -> Pictures:
    if fitted is None or findings.posterior is None or "fit" not in pictures.drawn:
        return pictures
    try:
        film = film_strip(findings.recordings[0], fitted, findings.beam, findings.posterior.stiffness, kept)
        return replace(pictures, film=film)
    except Exception as error:  # as for every picture
        pictures.failed["film"] = reason_of(error)
        return pictures


def _stiffness(findings: Run) -> Figure:
    posterior, learned, first = findings.posterior, findings.learned, findings.trainings[0]
    pushed = np.concatenate([comparison.push_s[np.isfinite(comparison.push_s)] for comparison in findings.trainings])
    return stiffness(
        findings.beam,
        uncertain=None if posterior is None else posterior.stiffness,
        regression=None if posterior is None or learned is None else learned.beam.stiffness,
        tags=dict(zip(first.tag_id.tolist(), first.marker_s.tolist(), strict=True)),
        push_s=float(pushed.max()) if pushed.size else None,
    )


def validation_figures(
    beam: Beam, pairs: Sequence[tuple[Comparison, Observations]], *others: Comparison
) -> dict[str, Draw]:
    """Bars for all recordings (`others` first), shapes and residuals of each."""
    if not pairs:
        return {}
    wanted: dict[str, Draw] = {"validation": partial(validation, (*others, *(comparison for comparison, _ in pairs)))}
    for i, (one, where) in enumerate(pairs, start=1):
        wanted[f"validation-{i}-shapes"] = partial(shapes, Shown(beam, one, where))
        wanted[f"validation-{i}-residuals"] = partial(residuals, one)
    return wanted


def fit(one: Shown, kept: KeptFrames) -> Figure | None:
    """The fit over the video frame; None without video or camera."""
    source, shown = one.observations.source, one.best
    if source.view is None or source.video is None:
        return None
    wanted = int(shown.frame[push_to_show(shown)])
    try:
        found = dict(kept.pictures(film_of(source.video, one.observations), [wanted], colour=True))
    except OnebendError:
        return None
    return fit_over_frame(found[wanted], source.view, one) if wanted in found else None


ROWS = 4000  # of the log
ARROW = 0.3  # of the beam's length
_EDGED_NARROW: dict[str, Any] = {"path_effects": [withStroke(linewidth=3.6, foreground="white")]}


MOST_NAMED_POSES = 12  # in one picture


def check_png(found: Overview) -> bytes | None:
    """A frame with tags, axis and largest force, and the force in time; without a film the tags in the plane, or
    None."""
    if found.preview is None and found.observations is None:
        return None
    return png_of(_drawn(found), software=SOFTWARE)


@styled
def _drawn(found: Overview) -> Figure:
    if found.curves:
        return _photos(found)
    with_log = found.log is not None
    figure, axes = blank(6.6 if with_log else 4.6, rows=2 if with_log else 1, height_ratios=[2, 1] if with_log else [1])
    if found.preview is not None:
        _frame(axes[0], found.recording, found.preview, found.log)
    else:
        _plane(axes[0], found)
    if found.log is not None:
        _force(axes[1], found, found.log)
    return figure


def _frame(axes: Axes, description: Recording, preview: Preview, log: ForceLog | None) -> None:
    at = preview.shown
    frame, tags = preview.looked[at], preview.sightings[at]
    expected = [tag.id for tag in (*description.tags.on_base, *description.tags.on_beam)]
    axes.imshow(frame.luma, cmap="gray", vmin=0, vmax=255)
    axes.set_axis_off()
    for tag in tags:
        colour = GREEN if tag.tag_id in expected else PINK
        axes.plot(*np.vstack([tag.corners, tag.corners[:1]]).T, color=colour, linewidth=1.8)
        low = tag.corners[np.argmax(tag.corners[:, 1])]
        below: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "top", "weight": "bold"}
        axes.annotate(str(tag.tag_id), low, (0, -7), color=colour, **below, **_EDGED_NARROW)
    if preview.markers is not None and preview.markers.view is not None:
        _axis(axes, description, preview, preview.markers.view, at, log)
    here = {tag.tag_id for tag in tags}
    ever = {tag.tag_id for found in preview.sightings for tag in found}
    missing = [f"{tag}{' (in other frames)' if tag in ever else ''}" for tag in expected if tag not in here]
    others = sorted(ever - set(expected))
    words = [f"frame {frame.index}: tags {_ids(sorted(here & set(expected)))} as expected"]
    words += [f"not seen: {', '.join(missing)}"] if missing else []
    words += [f"unexpected: {_ids(others)}"] if others else []
    axes.set_title("; ".join(words))


MOST_PHOTOS = 4
MOST_CURVES = 20  # of a film that are drawn


def _photos(found: Overview) -> Figure:
    """The first pictures, each about the body's curve in it."""
    assert found.observations is not None
    assert found.observations.pose_names is not None
    shown = list(zip(found.observations.pose_names, found.curves, strict=True))[:MOST_PHOTOS]
    figure, axes = blank(4.6, columns=len(shown))
    for one, (name, curve) in zip(axes, shown, strict=True):
        picture = read_photo(found.recording, name)
        one.imshow(picture)
        one.plot(
            *np.where(np.isfinite(curve.sd[0]), curve.px[0].T, np.nan), ".-", color=PINK, markersize=3, linewidth=1
        )
        low, high = curve.px[0].min(axis=0), curve.px[0].max(axis=0)
        margin = 0.15 * float(np.max(high - low))
        width, height = picture.size
        one.set_xlim(max(low[0] - margin, -0.5), min(high[0] + margin, width - 0.5))
        one.set_ylim(min(high[1] + margin, height - 0.5), max(low[1] - margin, -0.5))
        one.set_axis_off()
        one.set_title(figure_text(name))
    return figure


def _axis(axes: Axes, description: Recording, preview: Preview, view: View, at: int, log: ForceLog | None) -> None:
    assert preview.markers is not None
    markers, length = preview.markers, description.beam.length
    ends = project(view, np.array([[0.0, 0.0], [length, 0.0], [0.0, 0.25 * length]]))
    for end, name in ((ends[1], "x"), (ends[2], "y")):
        axes.annotate("", end, ends[0], arrowprops={"arrowstyle": "-|>", "color": BLUE, "linewidth": 1.4})
        axes.annotate(name, end, (5, 5), textcoords="offset points", color=BLUE, **_EDGED_NARROW)
    order = np.argsort(markers.s, kind="stable")
    s = np.concatenate([[0.0], markers.s[order]])
    points = np.concatenate([np.zeros((1, 2)), markers.xy[at, order]])
    good = np.isfinite(points).all(axis=1)
    axes.plot(*project(view, points[good]).T, color=BLUE, linewidth=1.6, linestyle=(0, (4, 3)), label="the beam's axis")
    _tool(axes, preview, view, s[good], points[good])
    place = description.push.at if description.push is not None else np.nan
    if log is None or not np.isfinite(place) or good.sum() < 2:
        return
    force = tared(description, log)
    largest = force[int(np.argmax(np.linalg.norm(force, axis=1)))]
    size = float(np.linalg.norm(largest))
    where = np.array([np.interp(place, s[good], points[good, k]) for k in (0, 1)])
    tail = where - ARROW * length * largest / size
    tip, start = project(view, np.stack([where, tail]))
    axes.annotate(
        f"F, {significant(size)} N", tip, start, arrowprops={"arrowstyle": "-|>", "color": ORANGE, "linewidth": 2.2},
        color=ORANGE, weight="bold", ha="center", va="center", **_EDGED_NARROW,
    )  # fmt: skip


def _tool(axes: Axes, preview: Preview, view: View, s: Array, points: Array) -> None:
    """The tool in the film: at `s` (P,) the axis goes through `points` (P, 2) [m]."""
    if not preview.tool.seen or len(s) < 2:
        return
    where = np.array([np.interp(preview.tool.s, s, points[:, k]) for k in (0, 1)])
    u, v = project(view, where).tolist()
    axes.plot(u, v, "x", color=PINK, markersize=9, markeredgewidth=2.4, **_EDGED_NARROW)
    beside: dict[str, Any] = {"textcoords": "offset points", "color": PINK, "weight": "bold"}
    axes.annotate(f"tool seen, s = {preview.tool.s:.2f}", (u, v), (9, 9), **beside, **_EDGED_NARROW)


def _plane(axes: Axes, found: Overview) -> None:
    assert found.observations is not None
    o = found.observations
    if o.pose_names is not None and len(o.time) <= MOST_NAMED_POSES:
        _poses(axes, o, o.pose_names)
    else:
        tags = tags_among(o)
        for i in np.flatnonzero(tags).tolist():
            axes.plot(*(1000.0 * o.xy[:, i]).T, ".", markersize=3, label=f"tag {o.tag_id[i]}, s = {o.marker_s[i]:.3g}")
        for curve in o.xy[np.linspace(0, len(o.time) - 1, MOST_CURVES).astype(int)][:, ~tags]:
            axes.plot(*(1000.0 * curve).T, color=PINK, linewidth=0.8)
    axes.plot([0.0, 1000.0 * o.length], [0.0, 0.0], color=BLUE, linewidth=1.4, label="the beam's x axis")
    axes.plot([0.0], [0.0], "s", color=INK)
    axes.set_aspect("equal", adjustable="datalim")
    shown = "poses" if o.static else "frames"
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title=f"{len(o.time)} {shown}, as read")
    axes.legend(loc="best")


def _poses(axes: Axes, o: Observations, names: Sequence[str]) -> None:
    """A line from the clamp through the points of each pose."""
    order = np.argsort(o.marker_s, kind="stable")
    for xy, name in zip(o.xy[:, order], names, strict=True):
        points = 1000.0 * np.concatenate([np.zeros((1, 2)), xy[np.isfinite(xy).all(axis=1)]])
        axes.plot(*points.T, "o-", markersize=3, linewidth=1.0, label=figure_text(name))


def _force(axes: Axes, found: Overview, log: ForceLog) -> None:
    force = tared(found.recording, log)
    every = max(1, len(force) // ROWS)
    for values, name, colour in zip(force[::every].T, ("along x", "along y"), (BLUE, ORANGE), strict=True):
        axes.plot(log.time[::every], values, color=colour, linewidth=0.9, label=name)
    for begin, end, pushed in pushes(found):
        axes.axvspan(
            begin, end, color=PINK if pushed else GREEN, alpha=0.13, linewidth=0, label="push" if pushed else "rest"
        )
    axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
    span = _film_span(found)
    if span is None:
        axes.set_title("force on the beam; the start of the film is not stated")
    else:
        clock = None if found.observations is None else found.observations.source.clock
        as_found = clock is not None and clock.found
        doubt = found.recording.start[1]
        within = f" (to {doubt:.2g} s)" if np.isfinite(doubt) and doubt > 0.0 else ""
        how = "as found" if as_found else f"at start_s as written{within}"
        axes.set_title(f"force on the beam; film, rest and push {how}")
        for at in span:
            axes.axvline(at, color=MUTED, linewidth=1.0, linestyle=(0, (2, 2)))
    axes.set(xlabel="time of the log [s]", ylabel="N, less its start")
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=len(unique))


def pushes(found: Overview) -> list[tuple[float, float, bool]]:
    """Begin, end [s, the log's clock], pushed or not, by tags and stated start."""
    start = found.recording.start[0]
    if found.observations is not None:
        time, loaded = found.observations.time, found.observations.loaded
    elif found.preview is not None and found.preview.markers is not None and np.isfinite(start):
        time, loaded = found.preview.markers.time + start, bent(found.preview.markers)
    else:
        return []
    return [*_push_spans(time, loaded, True), *_push_spans(time, ~loaded, False)]


def _push_spans(time: Array, mask: BoolArray, pushed: bool) -> list[tuple[float, float, bool]]:
    middle = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1]), time[-1:]])
    return [(float(middle[begin]), float(middle[end]), pushed) for begin, end in runs(mask).tolist()]


def _film_span(found: Overview) -> tuple[float, float] | None:
    start = found.recording.start[0]
    if found.observations is not None:
        return float(found.observations.time[0]), float(found.observations.time[-1])
    if found.preview is None or not np.isfinite(start):
        return None
    return start, start + found.preview.looked[-1].time


def _ids(ids: list[int]) -> str:
    return ", ".join(map(str, ids)) or "none"
