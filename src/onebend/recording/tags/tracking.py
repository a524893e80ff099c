"""Finding tags in pictures, and tracking them through a block of frames near their predicted places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from onebend.recording.tags.finder import NEAR, Finder, Sighting, margin_of
from onebend.recording.tags.pattern import correct_still
from onebend.recording.video import FilmFrame, Picture
from onebend.records import Array, BoolArray, IntArray

LOOK_EVERY = 8  # frames: how often the whole picture is searched for a tag that was lost
MOST_STEP = LOOK_EVERY // 2  # frames between searched ones: at two of them a tag must be seen to be predicted
BENT = 0.5  # px by which a tag's way may bend between searched frames; an eighth of it is off halfway
WIDE = 1.5  # margin around a tag's predicted place where `NEAR` found none, in tag sizes
EachTag = Callable[[Callable[[Finder, int], None], int], object]  # does `work(finder, i)` for every i below a count


@dataclass(frozen=True)
class BlockTracks:
    """The tags in one block of consecutive frames."""

    time: Array  # (B,) s
    corners: Array  # (B, m, 4, 2) px, NaN where not seen
    searched: BoolArray  # (B,)
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
    step: int = 1,
    each: EachTag | None = None,
) -> BlockTracks:
    """Follow the tags `tag_id` through consecutive frames.

    Each tag is searched near the place that its last two sightings predict. If a tag is missing, the whole picture is
    searched in the first frame, every `LOOK_EVERY` frames and in the last one. A second pass, backward in time, finds
    tags that became visible between two such searches. Where only every so manyth frame is searched, those between are
    searched as well where tags do not move on evenly, or come or go.

    Args:
        before: (B, m, 4, 2) px, where the tags were in the frames right before; they are followed from there.
        look: whether the whole first picture is searched even if no tag is missing, for strangers and doubles.
        step: of the frames' numbers: every so manyth is searched in any case; a power of two, `MOST_STEP` at most.
        each: works on all tags, with detectors of its own; default: one tag after the other.
    """
    known = 0 if before is None else min(len(before), LOOK_EVERY)
    tracks = np.full((known + len(frames), len(tag_id), 4, 2), np.nan)
    if before is not None:
        tracks[:known] = before[-known:]
    evenly = np.arange(len(tracks), dtype=float)
    number = np.arange(len(tracks)) - known + frames[0].index

    def followed(rows: Sequence[int], side: int) -> None:
        def one(searching: Finder, i: int) -> None:
            own = slice(i, i + 1)
            for t in rows:
                follow(tracks[:, own], evenly, t, side, frames[t - known].luma, tag_id[own], searching)

        if each is not None:
            each(one, len(tag_id))
        else:
            for i in range(len(tag_id)):
                one(finder, i)

    wanted = [t for t in range(known, len(tracks)) if number[t] % step == 0]
    looks, strangers, doubles, begin = 0, [], [], 0
    for end in sorted({*range(0, len(wanted), max(LOOK_EVERY // step, 1)), len(wanted) - 1} - {-1}):
        followed(wanted[begin : end + 1], -1)
        begin, t = end + 1, wanted[end]
        if np.isnan(tracks[t]).any() or (look and end == 0):
            sightings = finder.look(frames[t - known].luma, tag_id)
            looks += 1
            strangers += [tag.tag_id for tag in sightings if tag.tag_id not in tag_id]
            doubles += [(frames[t - known].index, tag) for tag in sure_doubles(sightings) if tag in tag_id]
            take(tracks[t], sightings, tag_id)
    followed(wanted[::-1], 1)
    searched = np.isfinite(tracks).all(axis=(2, 3)).any(axis=1) | (number % step == 0)
    while step > 1:
        more = [t for t in uneven(tracks, searched, number % step, step).tolist() if t >= known]
        followed(more, -1)
        followed(more, 1)
        searched[more] = True
        step //= 2
    tracks = correct_still(frames, tracks[known:], finder.cells)
    height, width = frames[0].luma.shape
    times = np.array([frame.time for frame in frames])
    return BlockTracks(times, tracks, searched[known:], (height, width), looks, tuple(strangers), tuple(doubles))


def uneven(tracks: Array, searched: BoolArray, phase: IntArray, step: int) -> IntArray:
    """Rows of `tracks` (T, m, 4, 2) in the middle between rows `step` apart, of which `phase` (T,) is 0, that the tags
    do not pass evenly. Rows beside what was not `searched` (T,) are passed evenly."""
    half, centre = step // 2, tracks.mean(axis=2)
    bent = np.zeros(len(tracks))
    for t in np.flatnonzero(searched & (phase == 0)).tolist():
        sides = [u for u in (t - step, t + step) if 0 <= u < len(tracks)]
        if len(sides) < 2 or not searched[sides].all():
            continue
        change = np.linalg.norm(centre[t - step] - 2.0 * centre[t] + centre[t + step], axis=-1)
        shown = np.isfinite(centre[[t - step, t, t + step]]).all(axis=-1)
        comes_or_goes = shown.any(axis=0) != shown.all(axis=0)
        bent[t] = np.inf if comes_or_goes.any() else np.nan_to_num(change).max()
    out = []
    for t in np.flatnonzero(phase == half).tolist():
        sides = [u for u in (t - half, t + half) if 0 <= u < len(tracks)]
        around = [u for u in (t - half - step, *sides, t + half + step) if 0 <= u < len(tracks)]
        if searched[sides].all() and bent[around].max() > BENT:
            out.append(t)
    return np.array(out, dtype=np.int64)


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
