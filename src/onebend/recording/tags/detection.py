"""A video to the corners of every tag in every frame, on all cores; the result does not depend on threads."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from queue import SimpleQueue
from typing import TypeVar

import numpy as np

from onebend.errors import ObservationError
from onebend.progress import Progress, Silent, track
from onebend.recording.tags.finder import Finder
from onebend.recording.tags.frozen import frozen, frozen_remarks, noting_changes, repeated
from onebend.recording.tags.tracking import MOST_STEP, BlockTracks, track_block
from onebend.recording.toml.entries import FAMILIES, TagsEntry
from onebend.recording.toml.source_entries import VideoEntry
from onebend.recording.video import FilmFrame, Keep, Picture, frame_count, pictures_at, rate_remarks, read_frames
from onebend.records import Array, BoolArray, Detections, Remark
from onebend.workers import available_cores

BLOCK = 16  # frames that are followed together; bounds the memory: two blocks are held at a time
WORTH_FINDER = 4  # tags: for fewer, one more detector is not worth its memory (20 MB) and its start
LOOK_BLOCKS = 16  # the first picture of every so manyth block is searched whole, whatever is missing
MOST_THREADS = 8
LEAST_RATE = 28.0  # searched frames a second at least: the clock search rests on how the tags move between them
FREQUENT = 0.1  # of the searched pictures: an unexpected tag gets a remark if it is seen more often
OFTEN_HIDDEN = 0.05  # of the frames: a tag that is missing more often gets a remark
FAMILY_FRAMES = 5  # frames searched for tags of other families when none was found

Item = TypeVar("Item")
Result = TypeVar("Result")


def detect_tags(
    video: VideoEntry,
    tags: TagsEntry,
    *,
    threads: int | None = None,
    progress: Progress = Silent(),
    keep: Keep | None = None,
) -> Detections:
    """Find every tag of `tags` in the frames of `video`: in as many as follow their motion, `LEAST_RATE` at least.

    A block of frames is followed, each tag by itself, while the next one is read, so the result does not depend on the
    number of `threads` (default: one per core) nor on their timing. `keep`: see `read_frames`.

    Raises:
        RecordingError: the video cannot be read to its end.
        ObservationError: no tag, no base tag or no beam tag was found, or one id is in the picture twice.
    """
    tag_id = [tag.id for tag in (*tags.on_base, *tags.on_beam)]
    threads = threads or min(available_cores(), MOST_THREADS)
    first, finders = Finder(tags.family), SimpleQueue[Finder]()
    for finder in (first, *(Finder(tags.family) for _ in range(min(threads, len(tag_id) // WORTH_FINDER) - 1))):
        finders.put(finder)

    def each(work: Callable[[Finder, int], None], count: int) -> None:
        def one(i: int) -> None:
            finder = finders.get()
            try:
                work(finder, i)
            finally:
                finders.put(finder)

        list(pool.map(one, range(count)))

    blocks: list[BlockTracks] = []
    changes: list[float] = []

    def follow_tags(frames: Sequence[FilmFrame]) -> BlockTracks:
        look, before = len(blocks) % LOOK_BLOCKS == 0, blocks[-1].corners if blocks else None
        step = step_of(blocks[0].time if blocks else np.array([frame.time for frame in frames]))
        blocks.append(track_block(frames, tag_id, first, before=before, look=look, step=step, each=each))
        return blocks[-1]

    with ThreadPoolExecutor(threads) as pool, ThreadPoolExecutor(1) as in_turn:
        frames = noting_changes(read_frames(video, keep), changes)
        tracked = in_order(in_turn, follow_tags, in_blocks(frames, BLOCK), ahead=1)
        for _ in track(progress, "Finding the tags", by_frame(tracked), frame_count(video)):
            pass
    return summary(video, tags, tag_id, blocks, repeated(changes))


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


def by_frame(blocks: Iterable[BlockTracks]) -> Iterator[BlockTracks | None]:
    """Each block once, then None for each further frame in it: one item per frame, for the progress."""
    for block in blocks:
        yield block
        yield from [None] * (len(block.time) - 1)


def summary(
    video: VideoEntry, tags: TagsEntry, tag_id: list[int], blocks: Sequence[BlockTracks], repeats: BoolArray
) -> Detections:
    """The blocks as one record, with remarks; an error where tags are missing or doubled. `repeats` (T,): pictures
    that are those before."""
    time = np.concatenate([block.time for block in blocks])
    corners = np.concatenate([block.corners for block in blocks])
    strangers = Counter(tag for block in blocks for tag in block.strangers)
    doubles = [double for block in blocks for double in block.doubles]
    searched = np.concatenate([block.searched for block in blocks])
    share, count = np.isfinite(corners[searched]).all(axis=(2, 3)).mean(axis=0), int(searched.sum())
    height, width = blocks[0].shape
    hung = frozen(corners, repeats)
    corners[hung] = np.nan
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
            *frozen_remarks(hung, time),
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
    """An error where no tag, no base tag or no beam tag was found in any frame, or one of them is never seen and
    others are that recording.toml does not name.

    `share` (m,) is the share of the `frames` that show each tag, `pictures` are some of them (empty: they are read).
    """
    base = len(tags.on_base)
    if not share.any():
        raise ObservationError(
            f"{video.file}: no tag of recording.toml is in any of the {frames} frames. "
            f"{what_is_there(video, tags, strangers, pictures, frames)}",
            about="unseen tag",
        )
    every = [tag.id for tag in (*tags.on_base, *tags.on_beam)]
    missing = [str(tag) for tag, shown in zip(every, share, strict=True) if not shown]
    if missing and strangers:
        seen = sorted({*strangers, *(tag for tag, shown in zip(every, share, strict=True) if shown)})
        raise ObservationError(
            f"{video.file}: tag {', '.join(missing)} is in none of {frames} frames; seen: {', '.join(map(str, seen))}. "
            "Correct the ids in recording.toml, or take out those that are not on the beam.",
            about="unseen tag",
        )
    for what, part, entries in (("base", share[:base], tags.on_base), ("beam", share[base:], tags.on_beam)):
        if not part.any():
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
    wanted = set(np.linspace(0, (len(pictures) or frames) - 1, FAMILY_FRAMES).astype(int).tolist())
    if pictures:
        pictures = [picture for i, picture in enumerate(pictures) if i in wanted]
    else:
        pictures = [picture for _, picture in pictures_at(video, wanted)]
    for family in FAMILIES:
        if family != tags.family:
            finder = Finder(family)
            ids_found = {tag.tag_id for picture in pictures for tag in finder.look(picture) if tag.errors == 0}
            if ids_found:
                ids = ", ".join(map(str, sorted(ids_found)))
                return f"These look like {family} (ids {ids}): correct [tags] family in recording.toml."
    need = "printed with a white rim, in focus, not mirrored and at least 20 pixels wide"
    return f"Check that the tags are {tags.family}, {need}."


def hidden_remarks(tag_id: Sequence[int], share: np.ndarray, frames: int) -> list[Remark]:
    """A remark for each tag that is missing in many frames."""
    remarks = []
    for tag, visible in zip(tag_id, share, strict=True):
        if 0 < visible < 1 - OFTEN_HIDDEN:
            text = f"Tag {tag} was not seen in {round((1 - visible) * frames)} of {frames} frames."
            remarks.append(Remark("note", text))
    return remarks


def unseen_remarks(tag_id: Sequence[int], share: np.ndarray, frames: int) -> list[Remark]:
    """A warning where tags are in no frame at all."""
    missing = [str(tag) for tag, visible in zip(tag_id, share, strict=True) if not visible]
    if not missing:
        return []
    seen = ", ".join(str(tag) for tag, visible in zip(tag_id, share, strict=True) if visible)
    text = f"Tag {', '.join(missing)} is in none of {frames} frames; seen: {seen}."
    text += " Correct the ids in recording.toml, or take out those that are not on the beam."
    return [Remark("warning", text, about="unseen tag")]


def stranger_remarks(strangers: Counter[int], looks: int) -> list[Remark]:
    """A remark on tags in the picture that recording.toml does not name."""
    often = sorted(tag for tag, count in strangers.items() if count > FREQUENT * looks)
    if not often:
        return []
    return [
        Remark("note", f"The picture also shows tags that recording.toml does not name: {', '.join(map(str, often))}.")
    ]
