"""One recording, from the first picture to the folder."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from onebend.errors import ObservationError, OnebendError, RecordingError
from onebend.live import body, guidance, live, recording_folder
from onebend.live.guidance import CaptureOutcome, CaptureSettings, CaptureState, Stages, Stop, TagView
from onebend.live.sources import CameraSource, Clock, End, ForceSource, Frame, HostClock, Samples, files_of, measurable
from onebend.progress import leave_real_time
from onebend.recording.entries import Recording
from onebend.recording.force import read_log
from onebend.recording.tags import TrackedFrame
from onebend.records import Array
from onebend.report.confidence import identified_ranges, typical_half_width
from onebend.report.sentences import say

# What follows a recording while it is made: the tags of each picture, and k(s).


class Follower:
    """Tags before the film begins, and tags and k(s) from then on. Not thread-safe."""

    def __init__(self, rec: Recording, settings: CaptureSettings) -> None:
        self.why = "" if settings.follow else "k(s) was not asked for"  # there is no k(s)
        self.rec, self._settings = rec, settings
        self._tracker = body.BodyTracker(rec)
        self._live: live.Live | None = None
        self._narrowest = guidance.Widening()

    def look(self, frame: Frame) -> tuple[tuple[TagView, ...], Array, list[str]]:
        """The tags and the outline (c, 2) px of a picture before the film begins, and what is to be better."""
        try:
            seen = self._tracker.step(frame.picture, frame.arrival, frame.colour)
        except ObservationError as wrong:
            return (), np.zeros((0, 2)), [str(wrong)]
        views = guidance.tag_views(self.rec.tags, seen.corners)
        advice = guidance.setup_advice(frame.picture, views, seen.strangers)
        return views, body.curve_in(seen), advice or ([self._tracker.why] if self._tracker.why else [])

    def begin(self, error: float) -> None:
        """The film begins, and its clock; that of the force is the same to `error` [s]."""
        self._tracker = body.BodyTracker(self.rec)
        if self._settings.follow:
            try:
                self._live = live.Live(
                    self.rec, clock=(0.0, error), settings=self._settings.live, beside=self._settings.live_beside
                )
            except RecordingError as wrong:
                self.why = str(wrong)

    def frame(self, frame: Frame, time: float) -> TrackedFrame | None:
        """Tags, and the outline, in a picture of the film; None where it is of no use."""
        if self._live is not None:
            return self._live.frame(frame.picture, time, frame.colour)
        try:
            return self._tracker.step(frame.picture, time, frame.colour)
        except ObservationError:
            return None

    def force(self, time: Array, force: Array, place: Array | None) -> None:
        """Rows of the force: times (n,) s on the film's clock, forces (n, 2) N, and perhaps the push's places (n,)."""
        if self._live is not None and len(time):
            self._live.force(time, force, place)

    def known(self) -> dict[str, Any]:
        """Of `CaptureState`: k(s), its half width, why it is wider than it was, and all that `Live` says."""
        if self._live is None:
            return {}
        state, width = self._live.state(), math.nan
        if state.stiffness is not None and identified_ranges(state.stiffness):
            width = float(np.expm1(typical_half_width(state.stiffness)))
        if width <= self._narrowest.half_width:
            self._narrowest = guidance.Widening(width, state.causes_of_width)
        why = self._narrowest.why(width, state.causes_of_width)
        return {"live": state, "stiffness": state.stiffness, "half_width": width, "wider": why}

    def close(self) -> None:
        if self._live is not None:
            self._live.close()


TagsSeen = Callable[[Frame, float, Array], None]  # of a picture: its time in the film [s], corners (b + m, 4, 2) px
LEAST_OFTEN = 0.15  # s: where pictures wait, one is searched for tags as often as that
MOST_UNWRITTEN = 30  # pictures that wait for the encoder; on a played clock none does
FIRST_LOOKS = 5  # frames of a good picture at least, before the film begins


def record(
    folder: Path | str,
    camera: CameraSource,
    force: ForceSource | None,
    settings: CaptureSettings = CaptureSettings(),
    watch: Callable[[CaptureState], None] = lambda _: None,
    stop: Stop | None = None,
    *,
    begin: Stop | None = None,
    clock: Clock | None = None,
    tags: TagsSeen = lambda *_: None,
    follower: Follower | None = None,
) -> CaptureOutcome:
    """Record one push into `folder`, which holds a `recording.toml` that names its film and its force log.

    It ends when the beam is at rest after a push (and k(s) is known to `settings.until`), when a source ends, when
    `stop` is set, or when the disk is full. What there is by then is in the folder.

    Args:
        watch: called from this thread some ten times a second; what it raises ends the recording.
        stop: set from anywhere to end it.
        begin: set from anywhere to begin the film in spite of what is wrong with the picture.
        clock: None: this machine's; `PlayedClock` plays played sources as fast as they can be read.
        tags: called from this thread with each picture of the film whose tags were searched.
        follower: None: one of its own.

    Raises:
        RecordingError: recording.toml, the camera or the sensor cannot be used; nothing was recorded then.
    """
    clock = clock or HostClock()
    columns = None if force is None else force.columns
    places = recording_folder.places_for(folder, columns, overwrite=settings.overwrite, read=files_of(camera, force))
    sources: list[CameraSource | ForceSource] = [camera, *([] if force is None else [force])]
    with ExitStack() as opened:
        for source in sources:
            source.open(clock)
            opened.callback(source.close)
        following = follower or Follower(places.rec, settings)
        session = _Session(places, camera, force, settings, watch, clock, tags, following)
        return session.run(stop or threading.Event(), begin or threading.Event())


class _Session:
    """What is under way."""

    def __init__(
        self,
        places: recording_folder.RecordingPlaces,
        camera: CameraSource,
        force: ForceSource | None,
        settings: CaptureSettings,
        watch: Callable[[CaptureState], None],
        clock: Clock,
        tags: TagsSeen,
        follower: Follower,
    ) -> None:
        self._places, self._settings, self._watch, self._clock, self._tags = places, settings, watch, clock, tags
        self._pump = recording_folder.Pump(camera, force, clock)
        self._camera, self._force = camera, force
        self._logs = recording_folder.Logs(
            camera.timing, None if force is None else force.timing, () if force is None else force.columns
        )
        self._film: recording_folder.FilmWriter | None = None
        self._encoder = ThreadPoolExecutor(1, "film", leave_real_time)  # neither tags nor force wait for it
        self._unwritten: deque[Future[bool]] = deque()
        self._most_unwritten = 0 if self._pump.at_will else MOST_UNWRITTEN
        self._stages = Stages(places.rec, settings, forced=force is not None)
        self._follower = follower
        self._newest = np.full(2, np.nan)  # N, the force
        self._early: deque[Frame | Samples] = deque()  # of the last moments before the film
        self._good, self._good_since = 0, math.nan
        self._state = CaptureState("exposure", until=settings.until)
        self._next_state = self._next_flush = self._next_stiffness = -math.inf
        self._why, self._fault = "", False
        self._force_end = ""
        self._followed = -math.inf  # s, this machine's clock: when a picture was searched for tags

    def run(self, stop: Stop, begin: Stop) -> CaptureOutcome:
        try:
            for item in self._pump:
                if item is not None:
                    self._take(*item)
                if self._film is None and begin.is_set() and any(isinstance(one, Frame) for one in self._early):
                    self._begin()
                self._now_and_then()
                if stop.is_set():
                    self._end("ended: stopped")
                if self._why:
                    break
        except KeyboardInterrupt:
            self._end("ended: stopped")
        except OSError as wrong:
            self._end("ended: not written", fault=True, why=wrong.strerror or wrong)
        finally:
            self._pump.close()
            self._renew()
            self._close()
        self._watch(self._state)
        return self._outcome()

    def _end(self, code: str, *, fault: bool = False, **values: Any) -> None:
        if not self._why:
            self._why, self._fault = say(code, **values), fault

    def _take(self, source: object, item: Frame | Samples | End) -> None:
        if isinstance(item, End):
            if source is self._camera or item.fault:
                self._end("ended: source", fault=item.fault, why=item.why)
            else:
                self._force_end = item.why
            return
        item = measurable(item) if isinstance(item, Samples) else item
        self._logs.see(item)
        if self._film is not None:
            self._keep(item)
            return
        self._early.append(item)
        if isinstance(item, Frame):
            self._set_up(item)

    def _keep(self, item: Frame | Samples) -> None:
        if isinstance(item, Frame):
            self._filmed(item)
        else:
            self._felt(item)

    def _set_up(self, frame: Frame) -> None:
        settings = self._settings
        while self._early and self._early[0].arrival < frame.arrival - settings.setup - 0.5:
            self._early.popleft()
        if settings.begin_at_once:
            self._begin()
            return
        if self._too_late():
            return
        views, outline, advice = self._follower.look(frame)
        self._good = 0 if advice else self._good + 1
        if advice or math.isnan(self._good_since):
            self._good_since = frame.arrival
        if self._force is not None and not any(isinstance(one, Samples) for one in self._early):
            advice.append(say("record: no force"))
        advice = advice or [say("picture: good")]
        shown = replace(self._state, picture=frame.picture, tags=views, outline=outline)
        self._state = replace(shown, advice=tuple(advice))
        if self._good >= FIRST_LOOKS and frame.arrival - self._good_since >= settings.setup:
            self._begin()

    def _begin(self) -> None:
        first = next(one for one in self._early if isinstance(one, Frame))
        height, width = first.picture.shape
        for path in self._places.earlier:
            path.unlink()
        on_one_clock = {"start_s": "0.0", "start_uncertainty_s": f"{self._logs.error:.4g}"}
        recording_folder.state_values(self._places.rec.folder, "video", on_one_clock)
        self._film = recording_folder.FilmWriter(self._places.film, (width, height), crf=self._settings.crf)
        self._logs.begin(self._places, first)
        self._follower.begin(self._logs.error)
        items = sorted(self._early, key=lambda one: one.arrival)
        self._early.clear()
        for item in items:
            self._keep(item)

    def _too_late(self) -> bool:
        now = self._clock.now()
        if self._pump.waiting > self._settings.most_waiting and now - self._followed < LEAST_OFTEN:
            return True
        self._followed = now
        return False

    def _filmed(self, frame: Frame) -> None:
        assert self._film is not None
        if frame.picture.shape != self._film.shape:
            self._end("ended: size", fault=True, camera=self._camera.name)
            return
        time = self._logs.frame(frame)
        if time is None:
            return
        self._unwritten.append(self._encoder.submit(self._film.write, frame.picture, time, frame.colour))
        self._written(self._most_unwritten)
        if self._too_late():
            self._state = replace(self._state, unfollowed=self._state.unfollowed + 1)
        elif (seen := self._follower.frame(frame, time)) is not None:
            self._tags(frame, time, seen.corners)
            self._stages.update(time, seen.corners, seen.places if isinstance(seen, body.BodyFrame) else None)
            views = guidance.tag_views(self._places.rec.tags, seen.corners)
            self._state = replace(self._state, picture=frame.picture, tags=views, outline=body.curve_in(seen))
        self._state = replace(self._state, seconds=time, frames=self._film.frames)
        if time > self._settings.longest:
            self._end("ended: longest", seconds=self._settings.longest)

    def _written(self, but: int = 0) -> None:
        """Wait until all pictures but the newest are in the film. Raises `OSError` where one was not."""
        while self._unwritten and (len(self._unwritten) > but or self._unwritten[0].done()):
            self._unwritten.popleft().result()

    def _felt(self, samples: Samples) -> None:
        time = self._logs.rows(samples)
        force = samples.force[:, self._places.wanted]
        self._stages.force(time, force)
        place = self._places.push_column
        self._follower.force(time, force, None if place is None else samples.force[:, place])
        good = np.flatnonzero(np.isfinite(force).all(axis=1))
        if len(good):
            self._newest = force[good[-1]]

    def _now_and_then(self) -> None:
        now, settings = self._clock.now(), self._settings
        if self._film is not None and now >= self._next_flush:
            self._next_flush = now + settings.flush_every
            self._logs.flush()
            left = recording_folder.room_left(self._places.rec.folder)
            self._state = replace(self._state, disk_left=left, bytes=self._film.bytes + self._logs.bytes)
            if left < settings.least_disk:
                self._end("ended: disk", fault=True, left=left / 1e6)
        if now >= self._next_state:
            self._next_state = now + settings.state_every
            self._renew()
            self._watch(self._state)

    def _renew(self) -> None:
        now, state, stages, settings = self._clock.now(), self._state, self._stages, self._settings
        if self._film is not None:
            if now >= self._next_stiffness or self._why:
                self._next_stiffness = now + settings.stiffness_every
                state = replace(state, **self._follower.known())
            rested = stages.stage == "last rest" and stages.rested >= settings.rest
            enough = math.isnan(settings.until) or state.half_width <= settings.until
            state = replace(
                state,
                stage="done" if rested and enough else stages.stage,
                advice=tuple(guidance.stage_advice(stages, settings, state.half_width)),
                displacement=stages.displacement,
                largest=stages.largest,
                tare=stages.tare,
                force=self._newest - stages.tare,
                drops=self._logs.drops,
                samples=self._logs.samples,
                lost_samples=self._logs.lost_samples,
                clock_sd=self._logs.clock_sd,
            )
            if state.stage == "done" and settings.ends:
                state = replace(state, advice=(say("record: done"),))
                self._end("ended: done")
        self._state = state

    def _close(self) -> None:
        self._follower.close()
        self._encoder.shutdown(wait=False)
        if self._film is None:
            return
        for close in (self._written, self._film.close, self._logs.finish):
            try:
                close()
            except OSError as wrong:
                self._fault = True
                self._why = say("recorded: not closed", why=self._why, wrong=wrong.strerror or wrong)
        self._state = replace(self._state, frames=self._film.frames)
        if not self._fault:
            self._read_back()

    def _read_back(self) -> None:
        """A recording whose log nothing can be learned from is none, whatever it ended by."""
        try:
            read_log(self._places.rec)
        except OnebendError as wrong:
            self._fault = True
            self._why = say("recorded: no log", why=self._why, wrong=wrong)

    def _outcome(self) -> CaptureOutcome:
        places, state, why = self._places, self._state, self._why or "its sources ended"
        remarks = [] if self._film is None else guidance.outcome_remarks(state, self._settings, self._stages)
        if self._follower.why and self._settings.follow:
            remarks.append(say("recorded: not learned", why=self._follower.why))
        if self._force_end and self._force is not None:
            remarks.append(say("recorded: short log", why=self._force_end))
        return CaptureOutcome(
            folder=places.rec.folder,
            film=None if self._film is None else places.film,
            log=None if self._film is None else places.log,
            why=why if self._film is not None or self._fault else guidance.not_begun(why, state.advice, self._settings),
            fault=self._fault,
            state=state,
            remarks=tuple(remarks),
        )
