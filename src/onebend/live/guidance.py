"""From rest to push to rest, as the tags show it while it goes on."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, get_args

import numpy as np

from onebend.beam.stiffness import UncertainStiffness
from onebend.live.live import LiveSettings, LiveState
from onebend.live.recording_folder import CRF
from onebend.options import option
from onebend.recording.entries import Recording, TagsEntry
from onebend.recording.preview import SMALLEST
from onebend.recording.signals import nan_mean
from onebend.recording.video import Picture
from onebend.records import Array
from onebend.report.sentences import say

# What a recorder is told, what it says while it records, and what it leaves.

Stage = Literal["exposure", "tare", "first rest", "push", "last rest", "done"]
STAGES: tuple[Stage, ...] = get_args(Stage)


class Stop(Protocol):
    """As `threading.Event`."""

    def is_set(self) -> bool: ...


@dataclass(frozen=True)
class CaptureSettings:
    """How a push is recorded."""

    until: float = math.nan  # stop when k(s) is known to this share (half the 95 % band, median); NaN: after one push
    ends: bool = True  # False: it goes on after the last rest, until it is stopped
    begin_at_once: bool = option("--now", False)
    follow: bool = option("--no-learning", True)
    setup: float = 1.0  # s for which the picture must be good before the film begins; they are in the film
    tare: float = 1.0  # s of the first rest that give the first zero of the force
    rest: float = 3.0  # s of each rest
    least_rest: float = 0.8  # s: a push that begins earlier begins the first rest anew
    share: float = 0.5  # of the beam's length by which the tip should move
    longest: float = option("--longest-s", 600.0, within=(1.0, 1e5))
    crf: int = option("--crf", CRF, metavar="N", within=(0, 40))
    flush_every: float = 0.5  # s: rows that a sudden end may lose
    state_every: float = 0.1  # s
    stiffness_every: float = 0.5  # s: reading k(s) takes some time
    least_disk: float = 200e6  # bytes: the film ends before the disk is full
    most_waiting: int = 4  # pictures: where more wait, they are filmed and not followed
    overwrite: bool = option("--overwrite", False)
    live: LiveSettings = field(default_factory=LiveSettings)
    live_beside: bool = True  # as `onebend.live.Live`


@dataclass(frozen=True)
class TagView:
    """A tag as the newest picture shows it."""

    id: int
    s: float  # its place along the beam; those of the base at 0
    corners: Array  # (4, 2) px; NaN where it is not seen
    on_base: bool

    @property
    def seen(self) -> bool:
        return bool(np.isfinite(self.corners).all())

    @property
    def side_px(self) -> float:
        """Mean side; NaN where it is not seen."""
        sides = np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=0), axis=1)
        return float(sides.mean())


@dataclass(frozen=True)
class CaptureState:
    """What is known while a push is recorded. NaN or None: not known yet."""

    stage: Stage
    advice: tuple[str, ...] = ()  # what to do now, the most urgent first
    picture: Picture | None = None  # (H, W), the newest
    tags: tuple[TagView, ...] = ()  # of the newest picture that was searched
    outline: Array = field(default_factory=lambda: np.zeros((0, 2)))  # (c, 2) px, in it; NaN where it is not seen
    force: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) N, newest, in the sensor's axes, less tare
    tare: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) N
    displacement: float = math.nan  # of the tip from its rest, as a share of the beam's length
    largest: float = math.nan  # of these so far
    stiffness: UncertainStiffness | None = None  # k(s) with its band
    half_width: float = math.nan  # of the band of k(s), as a share: 0.05 is 5 %
    wider: str = ""  # why the band is wider than it was; empty where it is not
    until: float = math.nan  # the half width that is wanted
    seconds: float = 0.0  # of film
    frames: int = 0  # in the film
    drops: int = 0  # frames that the camera took and that did not come, or came too late
    unfollowed: int = 0  # frames that are filmed, and were not searched for tags for want of time
    samples: int = 0  # rows of the force log
    lost_samples: int = 0  # rows that are known to be missing
    clock_sd: float = math.nan  # s, of the line that brings the force's stamps to the camera's clock
    bytes: int = 0  # of film and log
    disk_left: float = math.nan  # bytes
    live: LiveState | None = None  # tags, clock, verdict in full


WIDER = 1.15  # times as wide as the narrowest band so far
GREW = 1.1  # times as large, of what the width follows from
_WIDENS = {"tags": "wider: tags", "force": "wider: force", "drift": "wider: drift", "load": "wider: load"}


@dataclass(frozen=True)
class Widening:
    """The narrowest band so far, and what its width followed from."""

    half_width: float = math.inf
    causes: Mapping[str, float] = field(default_factory=dict)  # as `LiveHyperparameters.causes_of_width`

    def why(self, half_width: float, causes: Mapping[str, float]) -> str:
        """Why a band is wider than the narrowest; empty where it is not."""
        if not half_width > WIDER * self.half_width:
            return ""
        grown = {name: size / self.causes[name] for name, size in causes.items() if self.causes.get(name, 0.0) > 0.0}
        most = max(grown, key=lambda name: grown[name], default="")
        code = _WIDENS[most] if grown.get(most, 0.0) > GREW else "wider: review"
        return say(code, before=self.half_width, ratio=grown.get(most, 1.0))


@dataclass(frozen=True)
class CaptureOutcome:
    """What a recording left."""

    folder: Path
    film: Path | None  # None: nothing was recorded
    log: Path | None
    why: str  # it ended, in a sentence
    fault: bool  # it ended otherwise than asked for: a cable, a full disk
    state: CaptureState  # the last one
    remarks: tuple[str, ...] = ()  # what to know before learning from it

    @property
    def whole(self) -> bool:
        """Whether a film is there from a rest to a push and back."""
        return self.state.stage == "done"


def outcome_words(outcome: CaptureOutcome) -> str:
    """What was recorded, for people."""
    state, folder = outcome.state, outcome.folder
    size = f"{state.seconds:.1f} s, {state.frames} frames"
    missing = f" ({state.drops} more are missing)" if state.drops else ""
    rows = f", {state.samples} samples of the force" if outcome.log is not None else ""
    lines = [f"Recorded {folder}: {size}{missing}{rows}. It ended: {outcome.why}."]
    if math.isfinite(state.half_width):
        lines.append(f"k(s) so far: ± {100 * state.half_width:.2g} % (95 %, median).")
    lines += [f"{remark[0].upper()}{remark[1:]}." for remark in outcome.remarks]
    return "\n".join([*lines, f"Look at it with: onebend check {folder}   Learn from it with: onebend learn {folder}"])


def outcome_data(outcome: CaptureOutcome) -> dict[str, object]:
    """The same as data for `to_json`, SI."""
    state = outcome.state
    return {
        "folder": str(outcome.folder),
        "film": str(outcome.film),
        "log": None if outcome.log is None else str(outcome.log),
        "ended": outcome.why,
        "whole": outcome.whole,
        "stage": state.stage,
        "seconds": state.seconds,
        "frames": state.frames,
        "frames_missing": state.drops,
        "samples": state.samples,
        "samples_missing": state.lost_samples,
        "clock_sd_s": state.clock_sd,
        "half_width": state.half_width,
        "remarks": list(outcome.remarks),
    }


MOVED_SD = 8.0  # of a tag's place: farther from its rest than this,
MOVED_SHARE = 0.004  # and than this share of the beam's length, the beam has moved
BACK = 0.06  # of the largest displacement: nearer to the first rest than this is back
STILL = 0.4  # s
FAST = 0.5  # of the beam's length a second
STALLED = 0.7  # of the largest displacement: the tip goes back


class Stages:
    """Which stage a recording is in. Times are those of the film, s."""

    def __init__(self, rec: Recording, settings: CaptureSettings, *, forced: bool) -> None:
        """The film begins; `forced`: with a force sensor."""
        self.stage: Stage = "tare" if forced else "first rest"
        self.displacement = self.largest = math.nan  # of the tip, as a share of the beam's length
        self.speed = 0.0  # of the tip, lengths a second
        self.restless = False  # the first rest began anew
        self.short_rest = False
        self._settings, self._forced = settings, forced
        self._base = len(rec.tags.on_base)
        self._tip = int(np.argmax([tag.s for tag in rec.tags.on_beam])) if rec.tags.on_beam else -1
        self._length, self._size = rec.beam.length, rec.tags.size
        self._since = math.nan  # s, when the rest began
        self._rest: list[Array] = []  # (m, 2) lengths, of the frames of the first rest
        self._zero: Array | None = None  # (m, 2) where the tags are at rest
        self._threshold = MOVED_SHARE
        self._recent: deque[tuple[float, Array]] = deque()  # of the last moments
        self._forces: list[Array] = []  # (2,) N, of the first rest
        self._force_begin = self._force_end = math.nan

    @property
    def tare(self) -> Array:
        """(2,) N, the mean force of the first rest; NaN where none came."""
        return np.mean(self._forces, axis=0) if self._forces else np.full(2, np.nan)

    @property
    def rested(self) -> float:
        """s of the rest that goes on."""
        return self._recent[-1][0] - self._since if self._recent and not math.isnan(self._since) else 0.0

    @property
    def force_seen(self) -> bool:
        """Whether rows of the force came since the rest began."""
        return bool(self._forces)

    def force(self, time: Array, force: Array) -> None:
        """Rows of the force: times (n,) s, forces (n, 2) N."""
        if self.stage not in ("tare", "first rest"):
            return
        good = np.isfinite(force).all(axis=1) & (time >= (self._since if math.isfinite(self._since) else -math.inf))
        if good.any():
            self._forces += list(force[good])
            self._force_begin = float(np.fmin(self._force_begin, time[good].min()))
            self._force_end = float(np.fmax(self._force_end, time[good].max()))

    def update(self, time: float, corners: Array, body: Array | None = None) -> None:
        """The tags of one more frame, (b + m, 4, 2) px, or points of a body without tags (n, 2), in its lengths."""
        places = self._places(corners) if body is None else body
        if not np.isfinite(places).any():
            return
        self._recent.append((time, places))
        while self._recent[0][0] < time - STILL:
            self._recent.popleft()
        self._since = time if math.isnan(self._since) else self._since
        self._measure(places)
        if self.stage in ("tare", "first rest"):
            self._first_rest(time, places)
        elif self.stage == "push":
            self._pushed(time)
        elif self.stage == "last rest":
            self._last_rest(time)

    def _places(self, corners: Array) -> Array:
        """(m, 2) of the beam's tags from those of the base, in lengths of the beam."""
        centres = corners.mean(axis=1)
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).mean(axis=1)
        if not np.isfinite(sides).any():
            return np.full((len(corners) - self._base, 2), np.nan)
        unit = float(np.nanmedian(sides)) * self._length / self._size
        return np.asarray((centres[self._base :] - nan_mean(centres[: self._base])) / unit)

    def _measure(self, places: Array) -> None:
        if self._zero is None and not self._rest:
            return
        zero = nan_mean(np.array(self._rest)) if self._zero is None else self._zero
        away = np.linalg.norm(places - zero, axis=1)
        if np.isfinite(away).any():
            tip = float(away[self._tip])
            self.displacement = tip if math.isfinite(tip) else float(np.nanmax(away))
            self.largest = float(np.fmax(self.largest, self.displacement))
        (begin, first), (end, last) = self._recent[0], self._recent[-1]
        moved = np.linalg.norm(last - first, axis=1)
        if end > begin and np.isfinite(moved).any():
            self.speed = float(np.nanmax(moved)) / (end - begin)

    def _first_rest(self, time: float, places: Array) -> None:
        settings = self._settings
        if self._rest and self.displacement > self._moved_at():
            if time - self._since < settings.least_rest:
                self.restless, self._rest, self._forces, self._since = True, [], [], time
                self._force_begin = self._force_end = self.largest = math.nan
                self.stage = "tare" if self._forced else "first rest"
                return
            self.short_rest = time - self._since < settings.rest
            self._await_push()
            return
        self._rest.append(places)
        long_enough = self._force_end - self._force_begin >= settings.tare
        if self.stage == "tare" and long_enough and time - self._since >= settings.tare:
            self.stage = "first rest"
        if self.stage == "first rest" and time - self._since >= settings.rest:
            self._await_push()
            self.largest = math.nan
            self.restless = False

    def _await_push(self) -> None:
        self._zero, self._threshold, self.stage = nan_mean(np.array(self._rest)), self._moved_at(), "push"

    def _moved_at(self) -> float:
        """In lengths of the beam: what is farther from its rest has moved."""
        if len(self._rest) < 5:
            return 2.0 * MOVED_SHARE
        steps = np.abs(np.diff(np.array(self._rest), axis=0))
        steps = steps[np.isfinite(steps)]
        return max(MOVED_SHARE, MOVED_SD * float(np.median(steps))) if len(steps) else 2.0 * MOVED_SHARE

    def _pushed(self, time: float) -> None:
        bent = self.largest > 3.0 * self._threshold
        if bent and self.displacement < max(self._threshold, BACK * self.largest) and self._still():
            self._since, self.stage = time, "last rest"

    def _last_rest(self, time: float) -> None:
        if self.displacement > 2.0 * max(self._threshold, BACK * self.largest):
            self.stage, self._since = "push", time

    def _still(self) -> bool:
        (begin, _), (end, last) = self._recent[0], self._recent[-1]
        if end - begin < 0.8 * STILL:
            return False
        moved = [np.linalg.norm(places - last, axis=1) for _, places in self._recent]
        worst = np.concatenate(moved)
        return bool(np.nanmax(worst) < max(self._threshold, 0.01 * self.largest)) if np.isfinite(worst).any() else False


def stage_advice(stages: Stages, settings: CaptureSettings, half_width: float) -> list[str]:
    """What to do in this stage, the most urgent first."""
    stage, left = stages.stage, max(settings.rest - stages.rested, 0.0)
    if stage in ("tare", "first rest"):
        again = [say("record: moved")] if stages.restless else []
        lacks_force = stage == "tare" and not stages.force_seen
        return [*again, say("record: no force") if lacks_force else say("record: first rest", left=left)]
    if stage == "push":
        return _push_advice(stages, settings, half_width)
    if stage == "last rest":
        if left > 0.0:
            return [say("record: last rest", left=left)]
        code = "record: again" if math.isfinite(half_width) else "record: farther"
        return [say(code, band=half_width, wanted=settings.until)]
    return []


def _push_advice(stages: Stages, settings: CaptureSettings, half_width: float) -> list[str]:
    said = [say("record: slower")] if stages.speed > FAST else []
    largest = 0.0 if math.isnan(stages.largest) else stages.largest
    if half_width <= settings.until:
        return [*said, say("record: known", band=half_width)]
    if largest < settings.share:
        code = "record: push" if largest < 3.0 * MOVED_SHARE else "record: further"
        return [*said, say(code, moved=largest, wanted=settings.share)]
    return [*said, say("record: enough" if stages.displacement > STALLED * largest else "record: back")]


def outcome_remarks(state: CaptureState, settings: CaptureSettings, stages: Stages) -> list[str]:
    """What to know before learning from what was recorded."""
    said = []
    if stages.stage in ("tare", "first rest"):
        said.append(say("recorded: no push"))
    elif state.stage != "done":
        said.append(say("recorded: no last rest"))
    if stages.short_rest:
        said.append(say("recorded: short rest", wanted=settings.rest))
    if stages.stage in ("push", "last rest") and stages.largest < 0.8 * settings.share:
        said.append(say("recorded: small push", moved=stages.largest, wanted=settings.share))
    if state.drops > 0.05 * max(state.frames, 1):
        said.append(say("recorded: drops", missing=state.drops, frames=state.frames))
    if state.half_width > settings.until:
        said.append(say("recorded: wide band", band=state.half_width, wanted=settings.until))
    return said


# What to change before the film begins, from one picture and the tags in it.

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
    said, hidden = [], [tag.id for tag in tags if not tag.seen]
    if hidden:
        said.append(say("picture: hidden", tags=hidden, them="it" if len(hidden) == 1 else "them"))
    small = [tag for tag in seen if tag.side_px < SMALLEST]
    if small:
        sizes = ", ".join(f"tag {tag.id} is {tag.side_px:.0f} px" for tag in small)
        said.append(say("picture: small", sizes=sizes, least=SMALLEST))
    large = [tag for tag in seen if tag.side_px > LARGE * picture.shape[0]]
    if large:
        said.append(say("picture: large", tag=large[0].id, size=large[0].side_px))
    lights = {tag.id: tag_levels(picture, tag.corners) for tag in seen}
    burnt = [tag for tag, (_, _, share) in lights.items() if share > BURNT_SHARE]
    if burnt:
        said.append(say("picture: burnt tags", tags=burnt))
    flat = [tag for tag, (black, white, _) in lights.items() if white - black < LEAST_CONTRAST and tag not in burnt]
    if flat:
        black, white, _ = lights[flat[0]]
        said.append(say("picture: grey", tags=flat, levels=white - black))
    near = [tag.id for tag in seen if _at_edge(picture, tag)]
    return [*said, say("picture: edge", tags=near)] if near else said


def not_begun(why: str, advice: Sequence[str], settings: CaptureSettings) -> str:
    """Why a recording ended, and why it had not begun by then: the last `advice` says it."""
    if not advice:
        return say("not begun: no picture", why=why)
    wrong = [one for one in advice if one != say("picture: good")]
    return say("not begun", why=why, wrong=wrong[0] if wrong else say("picture: wait", seconds=settings.setup))


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
    level, wanted = float(picture.mean()), ", ".join(str(tag.id) for tag in tags)
    if level < DARK:
        return say("picture: dark")
    if level > BRIGHT:
        return say("picture: burnt")
    if strangers:
        return say("picture: other tags", found=", ".join(map(str, sorted(set(strangers)))), wanted=wanted)
    return say("picture: no tag", wanted=wanted)


def _at_edge(picture: Picture, tag: TagView) -> bool:
    away = np.minimum(tag.corners, np.array(picture.shape[::-1]) - 1 - tag.corners)
    return float(away.min()) < 0.3 * tag.side_px
