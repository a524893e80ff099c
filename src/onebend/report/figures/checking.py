"""One picture of a recording before it is learned from: what was understood, drawn over what was filmed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from onebend.recording.camera.lens import project
from onebend.recording.preview import Preview, bent
from onebend.recording.signals import runs
from onebend.recording.toml.entries import Recording
from onebend.records import Array, BoolArray, ForceLog, View
from onebend.report.figures.style import BLUE, FAINT, GREEN, INK, MUTED, ORANGE, PINK, blank, png_of, styled
from onebend.report.overview import SOFTWARE, Overview, tared
from onebend.report.wording import significant

ROWS = 4000  # of the log that are drawn
ARROW = 0.3  # of the beam's length
_EDGED: dict[str, Any] = {"path_effects": [withStroke(linewidth=3.6, foreground="white")]}


def check_picture(found: Overview) -> Figure | None:
    """A frame with the tags, the beam's axis and the largest force; below it the force over time.

    Of tracks and poses, which have no picture, the tags in the plane. None where there is nothing to draw.
    """
    return None if found.preview is None and found.observations is None else _drawn(found)


def check_png(found: Overview) -> bytes | None:
    """`check_picture` as PNG."""
    figure = check_picture(found)
    return None if figure is None else png_of(figure, software=SOFTWARE)


@styled
def _drawn(found: Overview) -> Figure:
    with_log = found.log is not None
    figure, axes = blank(6.6 if with_log else 4.6, rows=2 if with_log else 1, height_ratios=[2, 1] if with_log else [1])
    if found.preview is not None:
        _frame(axes[0], found.recording, found.preview, found.log)
    else:
        _plane(axes[0], found)
    if found.log is not None:
        _force(axes[1], found, found.log)
    return figure


def _frame(axes: Axes, rec: Recording, preview: Preview, log: ForceLog | None) -> None:
    """The frame that says most, the ids in it, the axis and the arrow."""
    at = preview.shown
    frame, tags = preview.looked[at], preview.sightings[at]
    expected = [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
    axes.imshow(frame.luma, cmap="gray", vmin=0, vmax=255)
    axes.set_axis_off()
    for tag in tags:
        colour = GREEN if tag.tag_id in expected else PINK
        axes.plot(*np.vstack([tag.corners, tag.corners[:1]]).T, color=colour, linewidth=1.8)
        low = tag.corners[np.argmax(tag.corners[:, 1])]
        below: dict[str, Any] = {"textcoords": "offset points", "ha": "center", "va": "top", "weight": "bold"}
        axes.annotate(str(tag.tag_id), low, (0, -7), color=colour, **below, **_EDGED)
    if preview.markers is not None and preview.markers.view is not None:
        _axis(axes, rec, preview, preview.markers.view, at, log)
    here = {tag.tag_id for tag in tags}
    ever = {tag.tag_id for found in preview.sightings for tag in found}
    missing = [f"{tag}{' (in other frames)' if tag in ever else ''}" for tag in expected if tag not in here]
    others = sorted(ever - set(expected))
    words = [f"frame {frame.index}: tags {_ids(sorted(here & set(expected)))} as expected"]
    words += [f"not seen: {', '.join(missing)}"] if missing else []
    words += [f"unexpected: {_ids(others)}"] if others else []
    axes.set_title("; ".join(words))


def _axis(axes: Axes, rec: Recording, preview: Preview, view: View, at: int, log: ForceLog | None) -> None:
    """The beam's x axis and y axis at the base, the line of its tags, and the largest force where it is said to act."""
    assert preview.markers is not None
    markers, length = preview.markers, rec.beam.length
    ends = project(view, np.array([[0.0, 0.0], [length, 0.0], [0.0, 0.25 * length]]))
    for end, name in ((ends[1], "x"), (ends[2], "y")):
        axes.annotate("", end, ends[0], arrowprops={"arrowstyle": "-|>", "color": BLUE, "linewidth": 1.4})
        axes.annotate(name, end, (5, 5), textcoords="offset points", color=BLUE, **_EDGED)
    order = np.argsort(markers.s, kind="stable")
    s = np.concatenate([[0.0], markers.s[order]])
    points = np.concatenate([np.zeros((1, 2)), markers.xy[at, order]])
    good = np.isfinite(points).all(axis=1)
    axes.plot(*project(view, points[good]).T, color=BLUE, linewidth=1.6, linestyle=(0, (4, 3)), label="the beam's axis")
    _tool(axes, preview, view, s[good], points[good])
    place = rec.push.at if rec.push is not None else np.nan
    if log is None or not np.isfinite(place) or good.sum() < 2:
        return
    force = tared(rec, log)
    largest = force[int(np.argmax(np.linalg.norm(force, axis=1)))]
    size = float(np.linalg.norm(largest))
    where = np.array([np.interp(place, s[good], points[good, k]) for k in (0, 1)])
    tail = where - ARROW * length * largest / size
    tip, start = project(view, np.stack([where, tail]))
    axes.annotate(
        f"F, {significant(size)} N", tip, start, arrowprops={"arrowstyle": "-|>", "color": ORANGE, "linewidth": 2.2},
        color=ORANGE, weight="bold", ha="center", va="center", **_EDGED,
    )  # fmt: skip


def _tool(axes: Axes, preview: Preview, view: View, s: Array, points: Array) -> None:
    """Where the film shows the tool: at `s` (P,) the axis goes through `points` (P, 2) [m]."""
    if not preview.tool.seen or len(s) < 2:
        return
    where = np.array([np.interp(preview.tool.s, s, points[:, k]) for k in (0, 1)])
    u, v = project(view, where).tolist()
    axes.plot(u, v, "x", color=PINK, markersize=9, markeredgewidth=2.4, **_EDGED)
    beside: dict[str, Any] = {"textcoords": "offset points", "color": PINK, "weight": "bold"}
    axes.annotate(f"tool seen, s = {preview.tool.s:.2f}", (u, v), (9, 9), **beside, **_EDGED)


def _plane(axes: Axes, found: Overview) -> None:
    """Where tracks or poses have the tags, in the beam's frame."""
    assert found.observations is not None
    o = found.observations
    for i, tag in enumerate(o.tag_id.tolist()):
        axes.plot(*(1000.0 * o.xy[:, i]).T, ".", markersize=3, label=f"tag {tag}, s = {o.marker_s[i]:.3g}")
    axes.plot([0.0, 1000.0 * o.length], [0.0, 0.0], color=BLUE, linewidth=1.4, label="the beam's x axis")
    axes.plot([0.0], [0.0], "s", color=INK)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", title=f"{len(o.time)} poses of the tags, as read")
    axes.legend(loc="best")


def _force(axes: Axes, found: Overview, log: ForceLog) -> None:
    """The force on the beam over time, with the film's span, its rests and its push."""
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
        axes.set_title("force on the beam; when the film begins is not written down")
    else:
        clock = None if found.observations is None else found.observations.source.clock
        as_found = clock is not None and clock.found
        how = "as found" if as_found else "at start_s as written" + _give(found.recording)
        axes.set_title(f"force on the beam; film, rest and push {how}")
        for at in span:
            axes.axvline(at, color=MUTED, linewidth=1.0, linestyle=(0, (2, 2)))
    axes.set(xlabel="time of the log [s]", ylabel="N, less its start")
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=len(unique))


def pushes(found: Overview) -> list[tuple[float, float, bool]]:
    """Begin, end [s, the log's clock] and whether the beam is pushed, by the tags and the start as written."""
    start = found.recording.start[0]
    if found.observations is not None:
        time, loaded = found.observations.time, found.observations.loaded
    elif found.preview is not None and found.preview.markers is not None and np.isfinite(start):
        time, loaded = found.preview.markers.time + start, bent(found.preview.markers)
    else:
        return []
    return [*_spans(time, loaded, True), *_spans(time, ~loaded, False)]


def _spans(time: Array, mask: BoolArray, pushed: bool) -> list[tuple[float, float, bool]]:
    middle = np.concatenate([time[:1], 0.5 * (time[1:] + time[:-1]), time[-1:]])
    return [(float(middle[begin]), float(middle[end]), pushed) for begin, end in runs(mask).tolist()]


def _film_span(found: Overview) -> tuple[float, float] | None:
    start = found.recording.start[0]
    if found.observations is not None:
        return float(found.observations.time[0]), float(found.observations.time[-1])
    if found.preview is None or not np.isfinite(start):
        return None
    return start, start + found.preview.looked[-1].time


def _give(rec: Recording) -> str:
    doubt = rec.start[1]
    return f" (to {doubt:.2g} s)" if np.isfinite(doubt) and doubt > 0.0 else ""


def _ids(ids: list[int]) -> str:
    return ", ".join(map(str, ids)) or "none"
