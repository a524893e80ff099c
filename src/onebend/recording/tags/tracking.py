"""Finding tags in pictures, and tracking them through a block of frames near their predicted places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from onebend.recording.tags.finder import NEAR, Finder, Sighting, margin_of
from onebend.recording.tags.pattern import correct_still
from onebend.recording.video import FilmFrame, Picture
from onebend.records import Array

LOOK_EVERY = 8  # frames: how often the whole picture is searched for a tag that was lost
WIDE = 1.5  # margin around a tag's predicted place where `NEAR` found none, in tag sizes
EachTag = Callable[[Callable[[Finder, int], None], int], object]  # does `work(finder, i)` for every i below a count


@dataclass(frozen=True)
class BlockTracks:
    """The tags in one block of consecutive frames."""

    time: Array  # (B,) s
    corners: Array  # (B, m, 4, 2) px, NaN where not seen
    shape: tuple[int, int]  # height, width, px
    looks: int  # how often the whole picture was searched
    strangers: tuple[int, ...]  # unexpected ids in those searches, one entry per sighting
    doubles: tuple[tuple[int, int], ...]  # (frame, id) where one id was read without error at two places


def track_block(
    frames: Sequence[FilmFrame],
    tag_id: Sequence[int],
    finder: Finder,
    *,
    before: Array | None = None,
    look: bool = True,
    each: EachTag | None = None,
) -> BlockTracks:
    """Follow the tags `tag_id` through consecutive frames.

    Each tag is searched near the place that its last two sightings predict. If a tag is missing, the whole picture is
    searched in the first frame, every `LOOK_EVERY` frames and in the last one. A second pass, backward in time, finds
    tags that became visible between two such searches.

    Args:
        before: (B, m, 4, 2) px, where the tags were in the frames right before; they are followed from there.
        look: whether the whole first picture is searched even if no tag is missing, for strangers and doubles.
        each: works on all tags, with detectors of its own; default: one tag after the other.
    """
    known = 0 if before is None else min(len(before), LOOK_EVERY)
    tracks = np.full((known + len(frames), len(tag_id), 4, 2), np.nan)
    if before is not None:
        tracks[:known] = before[-known:]
    evenly = np.arange(len(tracks), dtype=float)
    each = each or (lambda work, count: [work(finder, i) for i in range(count)])

    def followed(rows: range, step: int) -> None:
        def one(searching: Finder, i: int) -> None:
            own = slice(i, i + 1)
            for t in rows:
                follow(tracks[:, own], evenly, known + t, step, frames[t].luma, tag_id[own], searching)

        each(one, len(tag_id))

    looks, strangers, doubles, begin = 0, [], [], 0
    for t in sorted({*range(0, len(frames), LOOK_EVERY), len(frames) - 1}):
        followed(range(begin, t + 1), -1)
        begin = t + 1
        if np.isnan(tracks[known + t]).any() or (look and t == 0):
            sightings = finder.look(frames[t].luma, tag_id)
            looks += 1
            strangers += [tag.tag_id for tag in sightings if tag.tag_id not in tag_id]
            doubles += [(frames[t].index, tag) for tag in sure_doubles(sightings) if tag in tag_id]
            take(tracks[known + t], sightings, tag_id)
    followed(range(len(frames))[::-1], 1)
    tracks = correct_still(frames, tracks[known:], finder.cells)
    height, width = frames[0].luma.shape
    times = np.array([frame.time for frame in frames])
    return BlockTracks(times, tracks, (height, width), looks, tuple(strangers), tuple(doubles))


def follow(
    tracks: Array, time: Array, t: int, step: int, picture: Picture, tag_id: Sequence[int], finder: Finder
) -> None:
    """Seek in frame `t` every tag not yet found there, around where its sightings on the side of `step` (-1 the past,
    1 the future) predict it. `time` (T,) is of the frames, in any unit. Fills `tracks[t]`."""
    for i in np.flatnonzero(np.isnan(tracks[t]).any(axis=(1, 2))).tolist():
        expected, move = predict(tracks[:, i], time, t, step)
        if expected is None:
            continue
        for margin in (NEAR, WIDE):
            sightings = finder.look_around(picture, expected, margin_of(expected, margin) + margin * move)
            take(tracks[t, i : i + 1], sightings, tag_id[i : i + 1])
            if not np.isnan(tracks[t, i]).any():
                break


def predict(track: Array, time: Array, t: int, step: int) -> tuple[Array | None, float]:
    """Corners expected in frame `t` from the nearest two sightings within `LOOK_EVERY` frames on one side, moving on
    evenly in `time` (T,), and how far (px) they have moved since the nearest one. None where there is no sighting."""
    visible = [
        k
        for k in range(t + step, t + step * (LOOK_EVERY + 1), step)
        if 0 <= k < len(track) and not np.isnan(track[k]).any()
    ]
    if not visible:
        return None, 0.0
    first, nearest = visible[0], track[visible[0]]
    if len(visible) == 1:
        return nearest, 0.0
    second = visible[1]
    shift = (nearest - track[second]).mean(axis=0) * (time[t] - time[first]) / (time[first] - time[second])
    return nearest + shift, float(np.abs(shift).max())


def take(row: Array, sightings: Sequence[Sighting], tag_id: Sequence[int]) -> None:
    """Put the most certain sighting of each id into `row` (m, 4, 2), where it has none yet."""
    for i, wanted in enumerate(tag_id):
        if np.isnan(row[i]).any():
            row[i] = next((tag.corners for tag in sightings if tag.tag_id == wanted), np.nan)


def sure_doubles(sightings: Sequence[Sighting]) -> list[int]:
    """Ids that were read without an error at two places of one picture."""
    certain = [tag.tag_id for tag in sightings if tag.errors == 0]
    return sorted({tag for tag in certain if certain.count(tag) > 1})
