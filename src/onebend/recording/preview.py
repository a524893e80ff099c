"""A film looked at in some twenty frames, to know whether its tags can be learned from, and what would stop it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from onebend.errors import OnebendError, told
from onebend.progress import available_cores
from onebend.recording import camera, entries, outline, tag_finder
from onebend.recording.force_noise import displacement
from onebend.recording.tags import refuse_doubles, refuse_unseen, sure_doubles, take, unseen_remarks
from onebend.recording.tool import ToolPlace, not_seen, tool_in, tool_remarks
from onebend.recording.video import FilmFrame, picture_in, timed
from onebend.records import Array, BoolArray, Detections, Markers, Remark, of_markers, read_before_fit

LOOKS = 20  # frames that are searched for tags
MOST_READ = 4000  # frames that are read at most, two minutes of a usual film
SMALLEST = 20.0  # px, side of a tag: the corners of smaller ones are coarse, and below 16 px many are missed


@dataclass(frozen=True)
class Preview:
    """What some frames of a film show."""

    frames: int  # that were read
    whole: bool  # whether these are all
    looked: tuple[FilmFrame, ...]  # the frames that were searched
    sightings: tuple[tuple[tag_finder.Sighting, ...], ...]  # in each of these
    markers: Markers | None  # from the sightings; None where they make none
    remarks: tuple[Remark, ...]
    fault: str  # what would end the reading of the film; "" where nothing does
    tool: ToolPlace  # where these frames show the tool that pushes

    @property
    def shown(self) -> int:
        """Which of the looked at frames says most: the one in which the beam is bent most, else with most tags."""
        if self.markers is not None:
            return int(np.argmax(moved(self.markers)))
        return int(np.argmax([len(seen) for seen in self.sightings]))


def moved(markers: Markers) -> Array:
    """(P,) m, how far the tags are from where the first frame shows them."""
    return displacement(markers.time, markers.xy, markers.xy[0])


def bent(markers: Markers) -> BoolArray:
    """(P,) the frames in which the beam is not as in the first, where it is taken to be at rest."""
    away = moved(markers)
    # Of the largest displacement: nearer to the first frame than this is at rest.
    return np.asarray(away > 0.05 * float(away.max()))


def look_at(rec: entries.Recording) -> Preview:
    """Read the film (or its first `MOST_READ` frames), and look for tags in `LOOKS` frames spread evenly over it."""
    assert rec.video is not None
    looked, frames, whole = spread_frames(rec.video, LOOKS)
    ids = [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
    sightings = search(looked, rec.tags.family, ids)
    seen = Counter(tag.tag_id for found in sightings for tag in found)
    corners = np.full((len(looked), len(ids), 4, 2), np.nan)
    for row, found in zip(corners, sightings, strict=True):
        take(row, found, ids)
    share = np.isfinite(corners).all(axis=(2, 3)).mean(axis=0)
    height, width = looked[0].luma.shape
    markers, fault, remarks, tool = None, "", [*size_remarks(corners, ids)], not_seen("no tags")
    try:
        doubled = zip(looked, sightings, strict=True)
        refuse_doubles(rec.video, [(f.index, tag) for f, found in doubled for tag in sure_doubles(found) if tag in ids])
        strangers = Counter({tag: number for tag, number in seen.items() if tag not in ids})
        refuse_unseen(rec.video, rec.tags, share, strangers, [frame.luma for frame in looked], len(looked))
        remarks += unseen_remarks(ids, share, len(looked))
        time = np.array([frame.time for frame in looked])
        detections = Detections(time, np.array(ids), corners, width, height, ())
        tags = camera.measure_tags(detections, rec)
        markers = camera.with_checked_turns(tags.markers(), rec)
        if rec.traces_outline and markers.view is not None:
            numbers = np.array([frame.index for frame in looked])
            markers = outline.with_outline(tags, markers, numbers, apart=True)
        few = of_markers(markers, read_before_fit(markers))
        tool = tool_in([frame.luma for frame in looked], rec, few, bent(few))
        remarks += tool_remarks(tool, rec)
    except OnebendError as wrong:
        fault = told(wrong)
    return Preview(frames, whole, tuple(looked), sightings, markers, tuple(remarks), fault, tool)


def spread_frames(video: entries.VideoEntry, count: int) -> tuple[list[FilmFrame], int, bool]:
    """About `count` frames spread evenly over the film, how many it has, and whether it was read to its end."""
    kept: list[FilmFrame] = []
    step, read = 1, 0
    for index, time, raw in timed(video):
        if index % step == 0:
            kept.append(FilmFrame(index, time, picture_in(video, index, raw)))
        read = index + 1
        if len(kept) >= 2 * count:
            kept, step = kept[::2], 2 * step
        if read >= MOST_READ:
            break
    chosen = np.unique(np.rint(np.linspace(0, len(kept) - 1, count)).astype(int))
    return [kept[i] for i in chosen], read, read < MOST_READ


def search(frames: Sequence[FilmFrame], family: str, ids: Sequence[int]) -> tuple[tuple[tag_finder.Sighting, ...], ...]:
    """Every tag of the family in each frame; those of `ids` also where they are small."""
    threads = min(available_cores(), len(frames))
    parts = [frames[i::threads] for i in range(threads)]

    def look(part: Sequence[FilmFrame]) -> list[tuple[tag_finder.Sighting, ...]]:
        finder = tag_finder.Finder(family)
        return [tuple(finder.look(frame.luma, ids)) for frame in part]

    with ThreadPoolExecutor(threads) as pool:
        found = list(pool.map(look, parts))
    return tuple(found[i % threads][i // threads] for i in range(len(frames)))


def size_remarks(corners: Array, ids: Sequence[int]) -> list[Remark]:
    """A warning where tags (P, m, 4, 2) [px] are too small to be found reliably."""
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=2), axis=-1).mean(axis=2)
    small = [
        f"tag {tag} ({np.nanmedian(side):.0f} px)"
        for tag, side in zip(ids, sides.T, strict=True)
        if np.isfinite(side).any() and np.nanmedian(side) < SMALLEST
    ]
    if not small:
        return []
    text = f"These tags are less than {SMALLEST:.0f} pixels wide in the picture: {', '.join(small)}. Film from nearer."
    return [Remark("warning", text, about="small tags")]
