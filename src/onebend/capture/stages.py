"""From rest to push to rest, as the tags show it while it goes on."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from onebend.capture.state import CaptureSettings, CaptureState, Stage
from onebend.recording.toml.entries import Recording
from onebend.records import Array

MOVED_SD = 8.0  # of a tag's place: farther from its rest than this,
MOVED_SHARE = 0.004  # and than this share of the beam's length, the beam has moved
BACK = 0.06  # of the largest displacement: nearer to the first rest than this is back
STILL = 0.4  # s
FAST = 0.5  # of the beam's length a second
NO_FORCE = "no sample of the force has come yet: is the sensor switched on and its cable plugged in?"
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
        self._tip = int(np.argmax([tag.s for tag in rec.tags.on_beam]))
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

    def update(self, time: float, corners: Array) -> None:
        """The tags of one more frame, (b + m, 4, 2) px."""
        places = self._places(corners)
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
        base = centres[: self._base]
        origin = np.nanmean(base, axis=0) if np.isfinite(base).any() else np.full(2, np.nan)
        unit = float(np.nanmedian(sides)) * self._length / self._size
        return np.asarray((centres[self._base :] - origin) / unit)

    def _measure(self, places: Array) -> None:
        zero = self._zero if self._zero is not None else _mean(self._rest)
        if zero is None:
            return
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
            self._zero, self._threshold, self.stage = _mean(self._rest), self._moved_at(), "push"
            return
        self._rest.append(places)
        long_enough = self._force_end - self._force_begin >= settings.tare
        if self.stage == "tare" and long_enough and time - self._since >= settings.tare:
            self.stage = "first rest"
        if self.stage == "first rest" and time - self._since >= settings.rest:
            self._zero, self._threshold, self.stage = _mean(self._rest), self._moved_at(), "push"
            self.largest = math.nan
            self.restless = False

    def _moved_at(self) -> float:
        """In lengths of the beam: what is farther from its rest has moved."""
        if len(self._rest) < 5:
            return 2.0 * MOVED_SHARE
        steps = np.abs(np.diff(np.array(self._rest), axis=0))
        steps = steps[np.isfinite(steps)]
        return max(MOVED_SHARE, MOVED_SD * float(np.median(steps))) if len(steps) else 2.0 * MOVED_SHARE

    def _pushed(self, time: float) -> None:
        """At rest again after a push?"""
        bent = self.largest > 3.0 * self._threshold
        if bent and self.displacement < max(self._threshold, BACK * self.largest) and self._still():
            self._since, self.stage = time, "last rest"

    def _last_rest(self, time: float) -> None:
        if self.displacement > 2.0 * max(self._threshold, BACK * self.largest):
            self.stage, self._since = "push", math.nan
            self._since = time

    def _still(self) -> bool:
        (begin, _), (end, last) = self._recent[0], self._recent[-1]
        if end - begin < 0.8 * STILL:
            return False
        moved = [np.linalg.norm(places - last, axis=1) for _, places in self._recent]
        worst = np.concatenate(moved)
        return bool(np.nanmax(worst) < max(self._threshold, 0.01 * self.largest)) if np.isfinite(worst).any() else False


def _mean(places: list[Array]) -> Array | None:
    """(m, 2) mean of the sightings; NaN for a tag that was never seen."""
    if not places:
        return None
    stacked = np.array(places)
    count = np.isfinite(stacked).sum(axis=0)
    return np.asarray(np.where(count > 0, np.nansum(stacked, axis=0) / np.maximum(count, 1), np.nan))


def stage_advice(stages: Stages, settings: CaptureSettings, half_width: float, next_push: str = "") -> list[str]:
    """What to do in this stage, the most urgent first."""
    stage = stages.stage
    if stage in ("tare", "first rest"):
        again = ["the beam moved: the first rest begins anew. Touch nothing"] if stages.restless else []
        if stage == "tare" and not stages.force_seen:
            return [*again, NO_FORCE]
        left = max(settings.rest - stages.rested, 0.0)
        return [*again, f"touch nothing: the first rest takes {left:.0f} s more; it gives the zero of the force"]
    if stage == "push":
        return _push_advice(stages, settings, half_width)
    if stage == "last rest":
        left = max(settings.rest - stages.rested, 0.0)
        if left > 0.0:
            return [f"touch nothing: the last rest takes {left:.0f} s more; it shows the drift of the force"]
        wanted = f"the band is ± {100 * half_width:.2g} %, and ± {100 * settings.until:.2g} % is wanted"
        again = [f"{wanted}: push again"] if math.isfinite(half_width) else ["push again, slowly and farther"]
        return [*again, *([next_push] if next_push else [])]
    return []


def _push_advice(stages: Stages, settings: CaptureSettings, half_width: float) -> list[str]:
    said = ["more slowly: the tags blur, and the beam swings"] if stages.speed > FAST else []
    largest = 0.0 if math.isnan(stages.largest) else stages.largest
    if half_width <= settings.until:
        return [*said, f"the band is ± {100 * half_width:.2g} %, as wanted: let go slowly, and touch nothing"]
    if largest < settings.share:
        moved = f"the tip has moved by {100 * largest:.0f} % of the length, and {100 * settings.share:.0f} % is wanted"
        if largest < 3.0 * MOVED_SHARE:
            return [*said, "push now, slowly: the tip should move by half the length"]
        return [*said, f"further: {moved}"]
    if stages.displacement > STALLED * largest:
        return [*said, "far enough: go back slowly, let go, and touch nothing"]
    return [*said, "go back slowly, let go, and touch nothing"]


def outcome_remarks(state: CaptureState, settings: CaptureSettings, stages: Stages) -> list[str]:
    """What to know before learning from what was recorded."""
    said = []
    if stages.stage in ("tare", "first rest"):
        said.append("it shows no push: the beam never left its rest")
    elif state.stage != "done":
        said.append("it ends before the last rest: the drift of the force does not show")
    if stages.short_rest:
        said.append(f"the first rest was shorter than {settings.rest:g} s: the zero of the force is less sure")
    if stages.stage in ("push", "last rest") and stages.largest < 0.8 * settings.share:
        said.append(
            f"the tip moved by {100 * stages.largest:.0f} % of the length: {100 * settings.share:.0f} % tells more"
        )
    if state.drops > 0.05 * max(state.frames, 1):
        said.append(f"{state.drops} frames are missing beside {state.frames}: film at a lower rate or size")
    if state.half_width > settings.until:
        said.append(f"k(s) is known to ± {100 * state.half_width:.2g} %, and ± {100 * settings.until:.2g} % was wanted")
    return said
