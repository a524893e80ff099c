"""Frame by frame between two reviews: frames wait for their force, and are taught to the learner of the last review."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from onebend.learning.live.online_learner import OnlineLearner
from onebend.records import Array
from onebend.streaming.history import ForceHistory
from onebend.streaming.reading import AS_NEAR, FrameReader
from onebend.streaming.review import HALF, LONGEST_GAP, Later, Reviewed, logged_at, teach

_BEHIND = 2  # frames that came during a review, of which its learner is taught with each new one
_FEW_WAITING, _MOST_WAITING = 4, 300  # frames, before there is a learner and then
_SOON = 0.03  # s of newer frames, after which a force that is as near as the clocks are known is taken for that
_LATELY = 31  # frames, of which is known how far the log had come

Frame = tuple[float, Array]  # time [s, the frames' clock] and corners (m, 4, 2) px


@dataclass
class Learning:
    """A learner with what it needs of each frame, and the frames that it still has to see."""

    reader: FrameReader
    learner: OnlineLearner
    behind: deque[Frame] = field(default_factory=deque)
    learned: int = 0  # frames, one by one
    doubts: tuple[str, ...] = ()
    force: Array = field(default_factory=lambda: np.full(2, np.nan))  # (2,) N, at the last frame

    def update(self, log: ForceHistory, time: float, corners: Array, ahead: float) -> None:
        """Teach it one frame; `ahead`: as `FrameReader.stands_in`."""
        logged = logged_at(log, self.reader, time, self.reader.stands_in(ahead))
        self.force = self.reader.force_on_beam(logged[:2])
        doubts = teach(self.learner, self.reader, time, corners, logged)
        if doubts is not None:
            self.learned, self.doubts = self.learned + 1, tuple(doubts)


class Following:
    """The frames on their way into k(s)."""

    def __init__(self, log: ForceHistory, wait: float, most: int) -> None:
        """Nothing yet. A frame waits no longer than `wait` [s, of later frames] for its force; at most `most` frames
        are kept that no review has seen."""
        self.reviewed: Reviewed | None = None
        self.learning: Learning | None = None
        self.until = math.nan  # s, the frames' clock: of the last frame learned
        self._log, self._wait = log, wait
        self._coming: Learning | None = None  # of the last review, until it has seen all frames
        self._since: deque[Frame] = deque(maxlen=most)  # that no review has seen
        self._waiting: deque[Frame] = deque()  # the newest of them, whose force is not there yet
        self._ahead: deque[float] = deque(maxlen=_LATELY)  # s: of the log's newest row when a frame came, and its time

    @property
    def ahead(self) -> float:
        """s: what the log's newest row usually is ahead of a frame that comes in, by their own clocks."""
        return median(self._ahead) if self._ahead else -math.inf

    @property
    def stands_in(self) -> float:
        """s: so far after the newest row of the log frames are, by the clocks, and take its force; as a rule 0."""
        return 0.0 if self.learning is None else self.learning.reader.stands_in(self.ahead)

    @property
    def behind(self) -> float:
        """s: how far the frame that waits longest for its force is behind the newest; 0 where there is no learner."""
        waits = self.learning is not None and len(self._waiting) > 0
        return self._waiting[-1][0] - self._waiting[0][0] if waits else 0.0

    @property
    def kept(self) -> dict[str, int]:
        """Counts of the frames that are kept."""
        behind = 0 if self._coming is None else len(self._coming.behind)
        return {"waiting": len(self._waiting), "since": len(self._since), "behind": behind}

    def add(self, time: float, corners: Array) -> None:
        """One more frame, later than all before."""
        self._since.append((time, corners))
        self._waiting.append((time, corners))
        if len(self._log):
            self._ahead.append(self._log.newest - time)
        self.release()

    def release(self) -> None:
        """Teach the frames whose force is there, or that waited long enough."""
        learning = self.learning or self._coming
        if learning is None:
            while len(self._waiting) > _FEW_WAITING:
                self._waiting.popleft()
            return
        while self._waiting:
            time, corners = self._waiting[0]
            if not self._there(time, learning.reader) and len(self._waiting) < _MOST_WAITING:
                return
            self._waiting.popleft()
            if self.learning is not None:
                self.learning.update(self._log, time, corners, self.ahead)
            if self._coming is not None:
                self._coming.behind.append((time, corners))
                self._catch_up(self._coming)
            self.until = time

    def _there(self, time: float, reader: FrameReader) -> bool:
        """Whether a frame at `time` need not wait for more of the log."""
        waited, lacks, stands_in = self._waiting[-1][0] - time, time + reader.offset - self._log.newest, 0.0
        if lacks > -HALF:
            stands_in = reader.stands_in(self.ahead)
        near = min(AS_NEAR * reader.offset_sd, LONGEST_GAP)
        at_once = lacks <= (stands_in if stands_in > HALF else -HALF)
        return at_once or (waited >= _SOON and lacks <= near) or waited >= self._wait

    def later(self, made: Reviewed) -> Later:
        """What came after the last frame of a review, and is not waiting for its force."""
        frames = [frame for frame in self._released() if frame[0] > made.until]
        rows, begin = self._log.rows, 0
        if made.reader is not None:
            begin = int(np.searchsorted(rows[:, 0], made.until + made.reader.offset - 1.0))
        times, corners = tuple(time for time, _ in frames), tuple(one for _, one in frames)
        return Later(times, corners, rows[begin:].copy(), self.ahead)

    def take(self, made: Reviewed) -> None:
        """Go on from a review. Where it found less than the one before, that one stands, with the doubt."""
        before = self.reviewed
        if made.learner is None or made.reader is None:
            knew = before is not None and before.learner is not None
            self.reviewed = replace(before, why=made.why) if knew and before is not None else made
            return
        while self._since and self._since[0][0] <= made.until:
            self._since.popleft()
        self.reviewed = made
        self._coming = Learning(made.reader, made.learner, deque(self._released()))
        self._catch_up(self._coming)

    def _released(self) -> list[Frame]:
        """The frames that no review has seen and that do not wait."""
        waiting = {time for time, _ in self._waiting}
        return [frame for frame in self._since if frame[0] not in waiting]

    def _catch_up(self, coming: Learning) -> None:
        """Teach the learner of the last review some of the frames that it has not seen; it takes over when there are
        none."""
        for _ in range(min(_BEHIND, len(coming.behind))):
            coming.update(self._log, *coming.behind.popleft(), self.ahead)
        if not coming.behind:
            self.learning, self._coming = coming, None
