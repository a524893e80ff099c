"""What to change before the film begins, from one picture and the tags in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onebend.capture.state import CaptureSettings, TagView
from onebend.recording.preview import SMALLEST
from onebend.recording.toml.entries import TagsEntry
from onebend.recording.video import Picture
from onebend.records import Array

GOOD = "the picture is good: touch nothing, the film begins"
BURNT, BURNT_SHARE = 252, 0.2  # grey level, and share of a tag's brightest half that may reach it
LEAST_CONTRAST = 60  # grey levels between a tag's black and its white
DARK, BRIGHT = 35, 220  # mean grey level of a picture in which no tag is seen
LARGE = 0.25  # of the picture's height: a tag that is larger leaves the beam no room


def tag_views(tags: TagsEntry, corners: Array) -> tuple[TagView, ...]:
    """The tags of recording.toml with their corners (b + m, 4, 2) px, those of the base first."""
    entries = [*((tag, True) for tag in tags.on_base), *((tag, False) for tag in tags.on_beam)]
    return tuple(TagView(tag.id, tag.s, where, on_base) for (tag, on_base), where in zip(entries, corners, strict=True))


def setup_advice(picture: Picture, tags: Sequence[TagView], strangers: Sequence[int] = ()) -> list[str]:
    """What keeps this picture (H, W) from being a good one, the most urgent first; empty where nothing does."""
    seen = [tag for tag in tags if tag.seen]
    if not seen:
        return [_no_tag(picture, tags, strangers)]
    said = [_unseen(tags)] if len(seen) < len(tags) else []
    small = [tag for tag in seen if tag.side_px < SMALLEST]
    if small:
        sizes = ", ".join(f"tag {tag.id} is {tag.side_px:.0f} px" for tag in small)
        said.append(f"{sizes}: come nearer, until each is {SMALLEST:.0f} px or more")
    large = [tag for tag in seen if tag.side_px > LARGE * picture.shape[0]]
    if large:
        said.append(f"tag {large[0].id} is {large[0].side_px:.0f} px: go farther, so that the beam has room to bend")
    lights = {tag.id: tag_levels(picture, tag.corners) for tag in seen}
    burnt = [tag for tag, (_, _, share) in lights.items() if share > BURNT_SHARE]
    if burnt:
        said.append(f"{_tags(burnt)} {_is(burnt)} burnt out: expose for less, or take light away")
    flat = [tag for tag, (black, white, _) in lights.items() if white - black < LEAST_CONTRAST and tag not in burnt]
    if flat:
        black, white, _ = lights[flat[0]]
        said.append(
            f"{_tags(flat)} {_is(flat)} grey on grey ({white - black:.0f} levels): more light, or expose for longer"
        )
    return said + _at_edge(picture, seen)


def not_begun(why: str, advice: Sequence[str], settings: CaptureSettings) -> str:
    """Why a recording ended, and why it had not begun by then: the last `advice` says it."""
    if not advice:
        return f"{why} before a picture came"
    wrong = [one for one in advice if one != GOOD]
    return f"{why} before the picture was good: {wrong[0] if wrong else f'it must be good for {settings.setup:g} s'}"


def tag_levels(picture: Picture, corners: Array) -> tuple[float, float, float]:
    """Grey levels of a tag's black and white, and the share of its bright half that is burnt out."""
    height, width = picture.shape
    left, top = np.maximum(np.floor(corners.min(axis=0)), 0).astype(int)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)) + 1, (width, height)).astype(int)
    part = picture[top:bottom, left:right]
    if part.size < 16:
        return 0.0, 255.0, 0.0
    black, middle, white = np.quantile(part, (0.1, 0.5, 0.9))
    bright = part[part > 0.5 * (black + white)]
    share = float(np.mean(bright >= BURNT)) if len(bright) and white > middle - 1.0 else 0.0
    return float(black), float(white), share


def _no_tag(picture: Picture, tags: Sequence[TagView], strangers: Sequence[int]) -> str:
    level = float(picture.mean())
    if level < DARK:
        return "the picture is dark and shows no tag: open the lens cap, more light, or expose for longer"
    if level > BRIGHT:
        return "the picture is burnt out and shows no tag: expose for less, or take light away"
    if strangers:
        found = ", ".join(map(str, sorted(set(strangers))))
        return f"the tags in the picture are {found}, and recording.toml names {_ids(tags)}: correct the ids"
    return f"no tag is in the picture: bring tags {_ids(tags)} into it, in focus"


def _unseen(tags: Sequence[TagView]) -> str:
    hidden = [tag.id for tag in tags if not tag.seen]
    them = "it" if len(hidden) == 1 else "them"
    return f"{_tags(hidden)} {_is(hidden)} not seen: nothing may hide {them}, and no light may glare on {them}"


def _at_edge(picture: Picture, seen: Sequence[TagView]) -> list[str]:
    """A tag at the picture's edge leaves it when the beam bends."""
    height, width = picture.shape
    near = [
        tag.id
        for tag in seen
        if min(*tag.corners.min(axis=0), width - 1 - tag.corners[:, 0].max(), height - 1 - tag.corners[:, 1].max())
        < 0.3 * tag.side_px
    ]
    return [f"{_tags(near)} {_is(near)} at the picture's edge: leave room on all sides"] if near else []


def _tags(ids: Sequence[int]) -> str:
    return f"tag {ids[0]}" if len(ids) == 1 else f"tags {', '.join(map(str, ids[:-1]))} and {ids[-1]}"


def _is(ids: Sequence[int]) -> str:
    return "is" if len(ids) == 1 else "are"


def _ids(tags: Sequence[TagView]) -> str:
    return ", ".join(str(tag.id) for tag in tags)
