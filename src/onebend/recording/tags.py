"""Finding AprilTags in pictures and following them through a film."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice
from queue import SimpleQueue
from typing import TypeVar

import numpy as np

from onebend.errors import ObservationError
from onebend.progress import Progress, Silent, available_cores, track
from onebend.recording import tag_finder
from onebend.recording.entries import FAMILIES, TagsEntry, VideoEntry
from onebend.recording.signals import copies_in_motion, runs
from onebend.recording.video import (
    MOST_PIXELS,
    FilmFrame,
    Picture,
    frame_count,
    pictures_at,
    rate_remarks,
    read_frames,
)
from onebend.records import Array, BoolArray, Detections, IntArray, Remark, rotated

LOOK_EVERY = 8  # frames: how often the whole picture is searched for a tag that was lost
MOST_STEP = LOOK_EVERY // 2  # frames between searched ones: at two of them a tag must be seen to be predicted
WIDE = 1.5  # margin around a tag's predicted place where `NEAR` found none, in tag sizes
EachTag = Callable[[Callable[[tag_finder.Finder, int], None], int], object]  # `work(finder, i)` for i below a count


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
    finder: tag_finder.Finder,
    *,
    before: Array | None = None,
    look: bool = True,
    step: int = 1,
    each: EachTag | None = None,
) -> BlockTracks:
    """Follow the tags `tag_id` through consecutive frames.

    Each tag is searched near the place that its last two sightings predict. If one is missing, the whole picture is
    searched every `LOOK_EVERY` frames. A second pass, backward in time, finds tags that became visible in between.
    With a `step` (a power of two) only every so manyth frame is searched where tags move on evenly.

    Args:
        before: (B, m, 4, 2) px, where the tags were in the frames right before.
        look: whether the whole first picture is searched even if no tag is missing, for strangers and doubles.
        each: works on all tags, with detectors of its own; default: one tag after the other.
    """
    known = 0 if before is None else min(len(before), LOOK_EVERY)
    tracks = np.full((known + len(frames), len(tag_id), 4, 2), np.nan)
    if before is not None:
        tracks[:known] = before[-known:]
    evenly = np.arange(len(tracks), dtype=float)
    number = np.arange(len(tracks)) - known + frames[0].index

    def followed(rows: Sequence[int], side: int) -> None:
        def one(searching: tag_finder.Finder, i: int) -> None:
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
    tracks = tag_finder.correct_still(frames, tracks[known:], finder.cells)
    height, width = frames[0].luma.shape
    times = np.array([frame.time for frame in frames])
    return BlockTracks(times, tracks, searched[known:], (height, width), looks, tuple(strangers), tuple(doubles))


def uneven(tracks: Array, searched: BoolArray, phase: IntArray, step: int) -> IntArray:
    """Rows of `tracks` (T, m, 4, 2) in the middle between rows `step` apart, of which `phase` (T,) is 0, that the tags
    do not pass evenly. Rows beside what was not `searched` (T,) are passed evenly."""
    half, centre, beyond = step // 2, tracks.mean(axis=2), 2 * step
    rows = np.flatnonzero(searched & (phase == 0))
    known = np.pad(searched, beyond)
    rows = rows[known[beyond + rows - step] & known[beyond + rows + step]]
    near = centre[[rows - step, rows, rows + step]]  # (3, n, m, 2)
    shown = np.isfinite(near).all(axis=-1)
    comes_or_goes = (shown.any(axis=0) != shown.all(axis=0)).any(axis=-1)
    change = np.nan_to_num(np.linalg.norm(near[0] - 2.0 * near[1] + near[2], axis=-1)).max(axis=-1)
    bent, known = np.zeros(len(known)), np.pad(searched, beyond, constant_values=True)
    bent[beyond + rows] = np.where(comes_or_goes, np.inf, change)
    middle = np.flatnonzero(phase == half)
    around = beyond + middle + np.array([[-half - step], [-half], [half], [half + step]])
    # px by which a tag's way may bend between searched frames; an eighth of it is off halfway.
    return np.asarray(middle[known[around[1:3]].all(axis=0) & (bent[around].max(axis=0) > 0.5)])


def follow(
    tracks: Array, time: Array, t: int, step: int, picture: Picture, tag_id: Sequence[int], finder: tag_finder.Finder
) -> None:
    """Seek in frame `t` every tag not yet found, where its sightings on one side (-1 past, 1 future) predict it."""
    for i in np.flatnonzero(np.isnan(tracks[t]).any(axis=(1, 2))).tolist():
        expected, move = predict(tracks[:, i], time, t, step)
        if expected is None:
            continue
        for margin in (tag_finder.NEAR, WIDE):
            sightings = finder.look_around(picture, expected, tag_finder.margin_of(expected, margin) + margin * move)
            take(tracks[t, i : i + 1], sightings, tag_id[i : i + 1])
            if not np.isnan(tracks[t, i]).any():
                break


def predict(track: Array, time: Array, t: int, step: int) -> tuple[Array | None, float]:
    """Corners expected in frame `t` from the nearest two sightings within `LOOK_EVERY` frames on one side, moving on
    evenly in `time` (T,), and how far (px) they have moved since the nearest one. None where there is no sighting."""
    beside = range(t + step, t + step * (LOOK_EVERY + 1), step)
    visible = [k for k in beside if 0 <= k < len(track) and not np.isnan(track[k]).any()]
    if not visible:
        return None, 0.0
    first, nearest = visible[0], track[visible[0]]
    if len(visible) == 1:
        return nearest, 0.0
    second = visible[1]
    shift = (nearest - track[second]).mean(axis=0) * (time[t] - time[first]) / (time[first] - time[second])
    return nearest + shift, float(np.abs(shift).max())


def take(row: Array, sightings: Sequence[tag_finder.Sighting], tag_id: Sequence[int]) -> None:
    """Put the most certain sighting of each id into `row` (m, 4, 2), where it has none yet."""
    for i, wanted in enumerate(tag_id):
        if np.isnan(row[i]).any():
            row[i] = next((tag.corners for tag in sightings if tag.tag_id == wanted), np.nan)


def sure_doubles(sightings: Sequence[tag_finder.Sighting]) -> list[int]:
    """Ids that were read without an error at two places of one picture."""
    certain = [tag.tag_id for tag in sightings if tag.errors == 0]
    return sorted({tag for tag in certain if certain.count(tag) > 1})


# Pictures of a tag at one place, after which its pattern is fitted; after the last they are counted anew, and what was
# fitted before holds until the last again.
FITS = (8, 32, 64)


@dataclass
class _Window:
    """The pictures of one tag since it last moved, summed."""

    since: float  # s, of the first of them
    part: tuple[slice, slice]  # rows and columns of the picture
    grey: Array  # their sum
    corners: Array  # (4, 2) px, likewise
    count: int = 0
    fitted: int = 0  # pictures that the last fit was made of


@dataclass
class StillTags:
    """What was seen of each tag since it last moved; of bounded size. At most one pattern is fitted a picture."""

    cells: int | None  # along a tag's black square; None for families without a plain rim: nothing is corrected
    shifts: dict[int, Array] = field(default_factory=dict)  # (4, 2) px, by the tag's place in the list
    windows: dict[int, _Window] = field(default_factory=dict)

    def correct(self, picture: Picture, corners: Array, time: float) -> tuple[Array, Array]:
        """`corners` (m, 4, 2) px as the detector found them in the newest picture, at `time` [s], those of tags that
        stand still moved by what their patterns say; and (m,) s, since when each stands where it is, NaN where it was
        not seen. What a later picture says of the same stand holds for all of it."""
        since = np.full(len(corners), np.nan)
        if self.cells is None:
            return corners, since
        corrected, due = corners.copy(), -1
        for i in np.flatnonzero(np.isfinite(corners).all(axis=(1, 2))).tolist():
            window = self._with(i, picture, corners[i], time)
            since[i] = window.since
            late = next((count for count in FITS if window.fitted < count <= window.count), 0)
            due = i if due < 0 and late else due
        if due >= 0:
            self._fit(due)
        for i, shift in self.shifts.items():
            corrected[i] += shift  # a tag that is not seen stays NaN
        return corrected, since

    def _with(self, i: int, picture: Picture, corners: Array, time: float) -> _Window:
        """The window of tag `i`, this picture added; a new one where the tag has moved."""
        window = self.windows.get(i)
        if window is not None and np.abs(corners - window.corners / window.count).max() > tag_finder.STILL:
            self.shifts.pop(i, None)
            window = None
        if window is None or window.count >= FITS[-1]:
            part = tag_finder.part_around(corners, picture.shape)
            shape = tuple(one.stop - one.start for one in part)
            fitted = 0 if window is None else FITS[-2]
            window = self.windows[i] = _Window(time, part, np.zeros(shape), np.zeros((4, 2)), 0, fitted)
        window.grey += picture[window.part]
        window.corners = window.corners + corners
        window.count += 1
        return window

    def _fit(self, i: int) -> None:
        """Fit the pattern of tag `i` to the mean of its pictures."""
        assert self.cells is not None
        window = self.windows[i]
        mean, corner = window.corners / window.count, [window.part[1].start, window.part[0].start]
        fitted = tag_finder.fit_pattern(window.grey / window.count, mean - corner, self.cells)
        self.shifts.pop(i, None)
        if fitted is not None and np.abs(fitted + corner - mean).max() <= tag_finder.MOST_SHIFT:
            self.shifts[i] = fitted + corner - mean
        window.fitted = window.count


# Copies of pictures are known by their tags, which stand in them and then have gone on. The pixels of a packed film
# tell less: a copy may differ from its picture by as much as others do, and those of a beam at rest are copies, too.

STANDS, GOES_ON = 0.1, 0.2  # px, of a tag: in a copy, and at least after it
SHORT = 0.3  # s: longer stretches of copies are named one by one


def stale_remarks(stale: BoolArray, time: Array) -> tuple[Remark, ...]:
    """Warnings on the pictures that are left out: each long stretch, and the share of the others; `time` (T,) s."""
    stretches = [(begin, end, time[end] - time[begin - 1]) for begin, end in runs(stale).tolist()]
    texts = [
        f"The pictures of frames {begin} to {end - 1} only repeat the one before, and then the beam is elsewhere: "
        f"the film hung for {seconds:.2g} s. They are left out."
        for begin, end, seconds in stretches
        if seconds > SHORT
    ]
    if count := sum(end - begin for begin, end, seconds in stretches if seconds <= SHORT):
        texts.append(
            f"{count} of {len(stale)} pictures ({100 * count / len(stale):.2g} %) only repeat the one before while the "
            "beam moves, as where a camera or recorder drops frames. They are left out."
        )
    return tuple(Remark("warning", text, about="film hung") for text in texts)


BLOCK = 16  # frames that are followed together; bounds the memory: two blocks are held at a time
MOST_THREADS = 8
LEAST_RATE = 28.0  # searched frames a second at least: the clock search rests on how the tags move between them
FREQUENT = 0.1  # of the searched pictures: an unexpected tag gets a remark if it is seen more often

Item = TypeVar("Item")
Result = TypeVar("Result")


def detect_tags(
    video: VideoEntry,
    tags: TagsEntry,
    *,
    threads: int | None = None,
    progress: Progress = Silent(),
) -> Detections:
    """Find every tag of `tags` in the frames of `video`: in as many as follow their motion, `LEAST_RATE` at least.

    A block of frames is followed while the next one is read; the result does not depend on `threads` (default: one per
    core).

    Raises:
        RecordingError: the video cannot be read to its end.
        ObservationError: no tag, no base tag or no beam tag was found, or one id is in the picture twice.
    """
    tag_id = [tag.id for tag in (*tags.on_base, *tags.on_beam)]
    threads = threads or min(available_cores(), MOST_THREADS)
    first, finders = tag_finder.Finder(tags.family), SimpleQueue[tag_finder.Finder]()
    # Two tags for each detector: a further one takes 20 MB.
    for finder in (first, *(tag_finder.Finder(tags.family) for _ in range(min(threads, len(tag_id) // 2) - 1))):
        finders.put(finder)

    def each(work: Callable[[tag_finder.Finder, int], None], count: int) -> None:
        def one(i: int) -> None:
            finder = finders.get()
            try:
                work(finder, i)
            finally:
                finders.put(finder)

        list(pool.map(one, range(count)))

    blocks: list[BlockTracks] = []

    def follow_tags(frames: Sequence[FilmFrame]) -> BlockTracks:
        # The first picture of every so manyth block is searched whole, whatever is missing.
        look, before = len(blocks) % 16 == 0, blocks[-1].corners if blocks else None
        step = step_of(blocks[0].time if blocks else np.array([frame.time for frame in frames]))
        blocks.append(track_block(frames, tag_id, first, before=before, look=look, step=step, each=each))
        return blocks[-1]

    with ThreadPoolExecutor(threads) as pool, ThreadPoolExecutor(1) as in_turn:
        frames = track(progress, "Finding the tags", read_frames(video), frame_count(video))
        for _ in in_order(in_turn, follow_tags, in_blocks(frames, BLOCK), ahead=1):
            pass
    return summary(video, tags, tag_id, blocks)


def step_of(time: Array) -> int:
    """Every so manyth frame is searched in any case, of a film with frames at `time` (B,) [s]: a power of two."""
    step = 1
    while step < MOST_STEP and len(time) > 1 and 2 * step * float(np.median(np.diff(time))) <= 1 / LEAST_RATE:
        step *= 2
    return step


def in_blocks(items: Iterable[Item], size: int) -> Iterator[tuple[Item, ...]]:
    """Consecutive items, `size` at a time; the last block may be shorter."""
    items = iter(items)
    while block := tuple(islice(items, size)):
        yield block
        del block  # not to be held while the next one is read


def in_order(
    pool: ThreadPoolExecutor, work: Callable[[Item], Result], items: Iterable[Item], *, ahead: int
) -> Iterator[Result]:
    """`map(work, items)` on the pool, in order, with at most `ahead` + 1 items in work at a time."""
    waiting: deque[Future[Result]] = deque()
    for item in items:
        waiting.append(pool.submit(work, item))
        del item  # as in `in_blocks`
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def summary(video: VideoEntry, tags: TagsEntry, tag_id: list[int], blocks: Sequence[BlockTracks]) -> Detections:
    """The blocks as one record, with remarks; an error where tags are missing or doubled."""
    time = np.concatenate([block.time for block in blocks])
    corners = np.concatenate([block.corners for block in blocks])
    strangers = Counter(tag for block in blocks for tag in block.strangers)
    doubles = [double for block in blocks for double in block.doubles]
    searched = np.concatenate([block.searched for block in blocks])
    share, count = np.isfinite(corners[searched]).all(axis=(2, 3)).mean(axis=0), int(searched.sum())
    height, width = blocks[0].shape
    stale = copies_in_motion(time, corners.mean(axis=2), STANDS, GOES_ON)
    corners[stale] = np.nan
    refuse_doubles(video, doubles)
    looks = sum(block.looks for block in blocks)
    often = Counter({tag: count for tag, count in strangers.items() if count > FREQUENT * looks})
    refuse_unseen(video, tags, share, often, (), len(time))
    return Detections(
        time=time,
        tag_id=np.array(tag_id),
        corners=corners,
        width=width,
        height=height,
        remarks=(
            *rate_remarks(video, time),
            *stale_remarks(stale, time),
            *unseen_remarks(tag_id, share, len(time)),
            *hidden_remarks(tag_id, share, count),
            *stranger_remarks(strangers, looks),
        ),
        searched=None if searched.all() else searched,
    )


def refuse_doubles(video: VideoEntry, doubles: Sequence[tuple[int, int]]) -> None:
    """An error where one id is in the picture twice."""
    if doubles:
        tag = doubles[0][1]
        frames = [str(frame) for frame, tag_id in doubles if tag_id == tag]
        raise ObservationError(
            f"{video.file}: tag {tag} is in the picture twice (frame {', '.join(frames[:5])}"
            f"{', ...' if len(frames) > 5 else ''}). Cover or replace one of them and film again."
        )


def refuse_unseen(
    video: VideoEntry,
    tags: TagsEntry,
    share: np.ndarray,
    strangers: Counter[int],
    pictures: Sequence[Picture],
    frames: int,
) -> None:
    """An error where no tag, no base or no beam tag was found, or one is never seen and others are that nobody named.

    `share` (m,) of the `frames` shows each tag; `pictures` are some of them (empty: they are read)."""
    base = len(tags.on_base)
    if not share.any():
        raise ObservationError(
            f"{video.file}: no tag of recording.toml is in any of the {frames} frames. "
            f"{what_is_there(video, tags, strangers, pictures, frames)}",
            about="unseen tag",
        )
    every = [tag.id for tag in (*tags.on_base, *tags.on_beam)]
    missing = [tag for tag, shown in zip(every, share, strict=True) if not shown]
    if missing and strangers:
        text = missing_words(missing, sorted({*strangers, *every} - {*missing}), frames)
        raise ObservationError(f"{video.file}: {text[0].lower()}{text[1:]}", about="unseen tag")
    for what, part, entries in (("base", share[:base], tags.on_base), ("beam", share[base:], tags.on_beam)):
        if len(entries) and not part.any():
            ids = ", ".join(str(tag.id) for tag in entries)
            raise ObservationError(
                f"{video.file}: no {what} tag (id {ids}) is in any of the {frames} frames. Check the ids in "
                "recording.toml and that the tag is in the picture.",
                about="unseen tag",
            )


def what_is_there(
    video: VideoEntry, tags: TagsEntry, strangers: Counter[int], pictures: Sequence[Picture], frames: int
) -> str:
    """Advice for a video without any expected tag, from the tags that it does show."""
    if strangers:
        return f"The ids seen are {', '.join(map(str, sorted(strangers)))}: correct the ids in recording.toml."
    # Frames searched for tags of other families when none was found.
    wanted = sorted(set(np.linspace(0, (len(pictures) or frames) - 1, 5).astype(int).tolist()))
    pictures = [pictures[i] for i in wanted] if pictures else [picture for _, picture in pictures_at(video, wanted)]
    for family in (one for one in FAMILIES if one != tags.family):
        finder = tag_finder.Finder(family)
        found = {tag.tag_id for picture in pictures for tag in finder.look(picture) if tag.errors == 0}
        if found:
            ids = ", ".join(map(str, sorted(found)))
            return f"These look like {family} (ids {ids}): correct [tags] family in recording.toml."
    need = "printed with a white rim, in focus, not mirrored and at least 20 pixels wide"
    return f"Check that the tags are {tags.family}, {need}."


def hidden_remarks(tag_id: Sequence[int], share: np.ndarray, frames: int) -> list[Remark]:
    """A remark for each tag that is missing in many frames."""
    return [
        Remark("note", f"Tag {tag} was not seen in {round((1 - visible) * frames)} of {frames} frames.")
        for tag, visible in zip(tag_id, share, strict=True)
        if 0 < visible < 0.95
    ]


def unseen_remarks(tag_id: Sequence[int], share: np.ndarray, frames: int) -> list[Remark]:
    """A warning where tags are in no frame at all."""
    missing = [tag for tag, visible in zip(tag_id, share, strict=True) if not visible]
    seen = [tag for tag in tag_id if tag not in missing]
    return [Remark("warning", missing_words(missing, seen, frames), about="unseen tag")] if missing else []


def missing_words(missing: Sequence[int], seen: Sequence[int], frames: int) -> str:
    """A sentence on tags that no frame shows, and what to do."""
    ids, others = ", ".join(map(str, missing)), ", ".join(map(str, seen))
    text = f"Tag {ids} is in none of {frames} frames; seen: {others}."
    return f"{text} Correct the ids in recording.toml, or take out those that are not on the beam."


def stranger_remarks(strangers: Counter[int], looks: int) -> list[Remark]:
    """A remark on tags in the picture that recording.toml does not name."""
    often = ", ".join(str(tag) for tag, count in sorted(strangers.items()) if count > FREQUENT * looks)
    text = f"The picture also shows tags that recording.toml does not name: {often}."
    return [Remark("note", text)] if often else []


# Tracking picture by picture, for a camera that goes on filming. A lost tag is searched in one part of the picture a
# frame, so that no frame takes much longer than another, and near where the tag beside it says that it is.

TILE = 160  # px: a lost tag is sought in parts of about this size, one a frame
SQUARE: Array = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])  # corners of a tag of side 1


@dataclass(frozen=True)
class TrackedFrame:
    """The tags in one picture of a camera."""

    time: float  # s, the camera's own clock
    corners: Array  # (m, 4, 2) px, as in `records.Detections`; NaN where not seen
    detected: Array  # (m, 4, 2) px, the same before the patterns of tags at rest corrected them
    still_since: Array  # (m,) s, when each tag came to where it stands; NaN where it was not seen
    shape: tuple[int, int]  # height, width, px
    looked: bool = False  # the whole picture, or a part of it, was searched
    strangers: tuple[int, ...] = ()  # unexpected ids that were seen then
    doubles: tuple[int, ...] = ()  # ids that were read without error at two places


class Tracker:
    """Follows the tags of one camera. Not thread-safe; what it returns of a picture never changes afterwards."""

    def __init__(self, tag_id: Sequence[int], family: str = "tag36h11") -> None:
        """A tracker that has seen nothing of the tags `tag_id` (m,) of one AprilTag family."""
        self.tag_id = tuple(tag_id)
        self._finder = tag_finder.Finder(family)
        self._still = StillTags(self._finder.cells)
        self._rows: list[tuple[float, Array]] = []  # time and corners as detected, in order of time
        m = len(self.tag_id)
        self._last = np.full((m, m, 4, 2), np.nan)  # by tag: where all of them were when it was seen last
        self._turn, self._unseen = 0, 0
        self._shape: tuple[int, int] | None = None

    def step(self, picture: Picture, time: float) -> TrackedFrame:
        """The tags in one more picture, from it and those given before.

        Pictures should come in order of time [s]. One that is late, by up to `LOOK_EVERY` frames, is searched near
        where the tags were before and after it.

        Args:
            picture: (H, W) grey, 8 bit.
            time: s, the camera's clock, the middle of the exposure.

        Raises:
            ObservationError: not such a picture, or of another size than the first; a time that is no number, that was
                given before, or that is too late. The tracker stays as it was.
        """
        self._check(picture, time)
        t = sum(one < time for one, _ in self._rows)
        newest = t == len(self._rows)
        tracks = np.full((len(self._rows) + 1, len(self.tag_id), 4, 2), np.nan)
        times = np.insert(np.array([one for one, _ in self._rows]), t, time)
        for k, (_, corners) in enumerate(self._rows):
            tracks[k + (k >= t)] = corners
        for side in (-1, 1):
            follow(tracks, times, t, side, picture, self.tag_id, self._finder)
        sightings: list[tag_finder.Sighting] | None = None
        if newest and np.isnan(tracks).any(axis=(2, 3)).all(axis=0).any():
            sightings = self._look(picture, tracks[t])
            take(tracks[t], sightings or [], self.tag_id)
        self._rows.insert(t, (time, tracks[t]))
        del self._rows[:-LOOK_EVERY]
        corners, since = tracks[t], np.full(len(self.tag_id), np.nan)
        if newest:
            corners, since = self._still.correct(picture, tracks[t], time)
            seen = np.isfinite(tracks[t]).all(axis=(1, 2))
            self._last[seen] = tracks[t]
        found = sightings or []
        return TrackedFrame(
            time=time,
            corners=corners,
            detected=tracks[t],
            still_since=since,
            shape=(picture.shape[0], picture.shape[1]),
            looked=sightings is not None,
            strangers=tuple(tag.tag_id for tag in found if tag.tag_id not in self.tag_id),
            doubles=tuple(tag for tag in sure_doubles(found) if tag in self.tag_id),
        )

    def _check(self, picture: Picture, time: float) -> None:
        if not (isinstance(picture, np.ndarray) and picture.ndim == 2 and picture.dtype == np.uint8):
            what = f"{picture.dtype} of shape {picture.shape}" if isinstance(picture, np.ndarray) else type(picture)
            raise ObservationError(f"a picture must be a grey array (H, W) of uint8, not {what}. Convert it to grey")
        if not 0 < picture.size <= MOST_PIXELS:
            raise ObservationError(f"a picture of {picture.shape[1]} x {picture.shape[0]} cannot be searched")
        if self._shape not in (None, picture.shape):
            raise ObservationError(
                f"a picture of {picture.shape[1]} x {picture.shape[0]} after some of another size. Keep the camera's "
                "size as it is"
            )
        if not math.isfinite(time):
            raise ObservationError(f"the time of a picture is no number: {time}")
        if any(one == time for one, _ in self._rows):
            raise ObservationError(f"a picture of {time:.6f} s was given before")
        if len(self._rows) == LOOK_EVERY and time < self._rows[0][0]:
            raise ObservationError(f"a picture of {time:.6f} s is too late: {LOOK_EVERY} later ones were given")
        self._shape = (picture.shape[0], picture.shape[1])

    def _look(self, picture: Picture, row: Array) -> list[tag_finder.Sighting] | None:
        """Sightings in a part of the picture (in all of it where no tag was seen lately); None where not searched."""
        seen = np.isfinite(row).all(axis=(1, 2))
        lately = np.any([np.isfinite(corners).all(axis=(1, 2)) for _, corners in self._rows] or [~seen & seen], axis=0)
        if not (seen.any() or lately.any()):
            self._unseen += 1
            return self._finder.look(picture, self.tag_id) if self._unseen % LOOK_EVERY == 1 else None
        self._unseen, self._turn = 0, self._turn + 1
        lost = [i for i in np.flatnonzero(~seen).tolist() if not lately[i]]
        i = lost[self._turn // 2 % len(lost)]
        expected = _moved_along(self._last[i], row, i)
        if self._turn % 2 and expected is not None:
            return self._finder.look_around(picture, expected, tag_finder.margin_of(expected, WIDE))
        own = np.diagonal(self._last, axis1=0, axis2=1).transpose(2, 0, 1)  # (m, 4, 2)
        known = np.isfinite(own).all(axis=(1, 2))
        side = max(tag_finder.side_of(corners) for corners in own[known])
        places = _places(picture.shape)
        last = own[i] if expected is None and known[i] else own[known][0] if expected is None else expected
        order = np.argsort(np.linalg.norm(places - last.mean(axis=0), axis=1), kind="stable")
        middle = places[order[self._turn // 2 % len(places)]]
        # Parts overlap by 1.6 sides of a tag, so that one of them shows it whole.
        found = self._finder.look_around(picture, middle + side * SQUARE, 0.5 * TILE + 0.3 * side)
        return [tag for tag in found if tag.errors <= self._finder.most_errors]


def _places(shape: tuple[int, ...]) -> Array:
    """(P, 2) px, the middles of the parts of a picture of `shape`."""
    y, x = ((np.arange(count := max(1, math.ceil(size / TILE))) + 0.5) * size / count for size in shape[:2])
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _moved_along(then: Array, now: Array, i: int) -> Array | None:
    """Corners (4, 2) px of the hidden tag `i`, moved with the nearest seen both `then` and `now` (m, 4, 2); or None."""
    both = np.flatnonzero((np.isfinite(then) & np.isfinite(now)).all(axis=(1, 2)))
    if not len(both) or not np.isfinite(then[i]).all():
        return None
    away = np.linalg.norm(then[both].mean(axis=1) - then[i].mean(axis=0), axis=1)
    beside = int(both[np.argmin(away)])
    before, after = then[beside].mean(axis=0), now[beside].mean(axis=0)
    one, other = then[beside] - before, now[beside] - after
    turn = np.arctan2(np.sum(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]), np.sum(one * other))
    return np.asarray(rotated(then[i] - before, turn) + after)
