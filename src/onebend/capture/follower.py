"""What follows a recording while it is made: the tags of each picture, and k(s)."""

from __future__ import annotations

from typing import Any

import numpy as np

from onebend.beam.profiles.uncertain import UncertainStiffness
from onebend.capture.guidance import setup_advice, tag_views
from onebend.capture.next_push import NextPush
from onebend.capture.sources import Frame
from onebend.capture.state import CaptureSettings, TagView
from onebend.errors import ObservationError, RecordingError
from onebend.recording.tags.tracker import Tracker
from onebend.recording.toml.entries import Recording
from onebend.recording.video import Picture
from onebend.records import Array
from onebend.report.confidence import identified_ranges, typical_half_width
from onebend.streaming.live import Live, seen_by


class Follower:
    """Tags before the film begins, and tags and k(s) from then on. Not thread-safe."""

    def __init__(self, rec: Recording, settings: CaptureSettings) -> None:
        self.why = "" if settings.follow else "k(s) was not asked for"  # there is no k(s)
        self._rec, self._settings = rec, settings
        ids = [tag.id for tag in (*rec.tags.on_base, *rec.tags.on_beam)]
        self._tracker = Tracker(ids, rec.tags.family)
        self._live: Live | None = None
        self._next = NextPush(beside=settings.live_beside)

    def look(self, frame: Frame) -> tuple[tuple[TagView, ...], list[str]]:
        """The tags of a picture before the film begins, and what is to be better."""
        try:
            seen = self._tracker.step(frame.picture, frame.arrival)
        except ObservationError as wrong:
            return (), [str(wrong)]
        views = tag_views(self._rec.tags, seen.corners)
        return views, setup_advice(frame.picture, views, seen.strangers)

    def begin(self, error: float) -> None:
        """The film begins, and its clock; that of the force is the same to `error` [s]."""
        self._tracker = Tracker(self._tracker.tag_id, self._rec.tags.family)
        if self._settings.follow:
            try:
                self._live = Live(
                    self._rec, clock=(0.0, error), settings=self._settings.live, beside=self._settings.live_beside
                )
            except RecordingError as wrong:
                self.why = str(wrong)

    def frame(self, picture: Picture, time: float) -> Array | None:
        """(b + m, 4, 2) px, the tags of a picture of the film; None where it is of no use."""
        if self._live is not None:
            seen = self._live.frame(picture, time)
            return None if seen is None else seen.corners
        try:
            return self._tracker.step(picture, time).corners
        except ObservationError:
            return None

    def force(self, time: Array, force: Array, place: Array | None) -> None:
        """Rows of the force: times (n,) s on the film's clock, forces (n, 2) N, and perhaps the push's places (n,)."""
        if self._live is not None and len(time):
            self._live.force(time, force, place)

    def known(self) -> dict[str, Any]:
        """Of `CaptureState`: k(s), its half width, and all that `Live` says."""
        if self._live is None:
            return {}
        state = self._live.state()
        return {"live": state, "stiffness": state.stiffness, "half_width": half_width_share(state.stiffness)}

    def plan(self) -> None:
        """Begin to find what the next push should be."""
        if self._live is not None:
            self._next.ask(seen_by(self._live), self._settings.live.observing)

    @property
    def next_push(self) -> str:
        """What the next push should be; empty where that was not asked, or is not known yet."""
        return self._next.words

    def close(self) -> None:
        """End what learns beside this process."""
        self._next.close()
        if self._live is not None:
            self._live.close()


def half_width_share(stiffness: UncertainStiffness | None) -> float:
    """Half the 95 % band of k(s), its median, as a share of k; NaN where k(s) is identified nowhere."""
    if stiffness is None or not identified_ranges(stiffness):
        return float("nan")
    return float(np.expm1(typical_half_width(stiffness)))
