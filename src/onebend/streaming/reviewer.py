"""Who makes the reviews of a stream: this process, at once, or another one beside it, so that no frame waits."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any, Protocol

from onebend.learning.live.settings import OnlineSettings
from onebend.recording.observe import ObserveSettings
from onebend.streaming.review import ENDED, Later, Reviewed, Seen, go_on, review
from onebend.workers import interrupts_held, leave_interrupts_to_parent

NICE = 5  # added to the niceness of the process that reviews


class Reviewer(Protocol):
    """Makes one review at a time."""

    @property
    def busy(self) -> bool:
        """Whether a review is being made."""
        ...

    def begin(self, seen: Seen) -> None:
        """Begin a review."""
        ...

    def result(self, since: Callable[[Reviewed], Later]) -> Reviewed | None:
        """The review, once it is made; `since` gives what came after its last frame. Does not wait."""
        ...

    @property
    def spent(self) -> float:
        """s of this process's time that reviews took so far."""
        ...

    def close(self) -> None:
        """End it; nothing more may be begun."""
        ...


class ReviewerHere:
    """Reviews at once, in this process: the same stream gives the same results, whatever the machine."""

    def __init__(self, observing: ObserveSettings, learning: OnlineSettings) -> None:
        self._settings = observing, learning
        self._made: Reviewed | None = None
        self._spent = 0.0

    @property
    def busy(self) -> bool:
        return self._made is not None

    def begin(self, seen: Seen) -> None:
        begun = time.thread_time()
        self._made = review(seen, *self._settings)
        self._spent += time.thread_time() - begun

    def result(self, since: Callable[[Reviewed], Later]) -> Reviewed | None:  # noqa: ARG002 (nothing came meanwhile)
        made, self._made = self._made, None
        return made

    @property
    def spent(self) -> float:
        return self._spent

    def close(self) -> None:
        self._made = None


class ReviewerBeside:
    """Reviews in a process of its own, which ends with this object, or with the process that made it.

    When a review is made, the frames that came meanwhile are sent after it, so that its learner is nearly up to date
    when it comes back.
    """

    def __init__(self, observing: ObserveSettings, learning: OnlineSettings) -> None:
        self._settings = observing, learning
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: SimpleQueue[Reviewed | None] = SimpleQueue()
        self._messages: SimpleQueue[bytes] = SimpleQueue()
        self._until, self._caught_up, self._busy = 0.0, False, False
        self._start()  # it loads what it needs while the first frames come

    @property
    def busy(self) -> bool:
        return self._busy

    def begin(self, seen: Seen) -> None:
        self._until, self._caught_up, self._busy = seen.until, False, True
        if self._process is None or self._process.poll() is not None:
            self._start()
        self._send(seen)

    def result(self, since: Callable[[Reviewed], Later]) -> Reviewed | None:
        try:
            made = self._answers.get_nowait()
        except Empty:
            return None
        if made is None:
            self.close()
            return Reviewed(self._until, ENDED)
        if self._caught_up or made.reader is None:
            self._busy = False
            return made
        self._caught_up = True
        self._send(since(made))
        return None

    @property
    def spent(self) -> float:
        return 0.0

    def close(self) -> None:
        self._end()
        self._process, self._busy = None, False

    def _start(self) -> None:
        self._answers, self._messages = SimpleQueue(), SimpleQueue()
        path = os.pathsep.join(one or str(Path.cwd()) for one in sys.path)
        with interrupts_held():
            self._process = process = subprocess.Popen(
                [sys.executable, "-c", "from onebend.streaming.reviewer import serve; serve()"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": path},
            )
        self._end = weakref.finalize(self, _end, process, self._messages)
        threading.Thread(target=_listen, args=(process.stdout, self._answers), daemon=True).start()
        threading.Thread(target=_write, args=(process.stdin, self._messages), daemon=True).start()
        self._send(self._settings)

    def _send(self, message: object) -> None:
        self._messages.put(pickle.dumps(message))


def _end(process: subprocess.Popen[bytes], messages: SimpleQueue[bytes]) -> None:
    messages.put(b"")
    process.kill()
    process.wait()


def _write(stream: IO[bytes], messages: SimpleQueue[bytes]) -> None:
    """Pass on what is to be sent: a pipe takes no more at once than the other side reads. Empty bytes are the end."""
    with suppress(OSError):  # the process ended: `_listen` notices
        while data := messages.get():
            stream.write(data)
            stream.flush()
    with suppress(OSError):
        stream.close()


def _listen(stream: IO[bytes], answers: SimpleQueue[Reviewed | None]) -> None:
    """Pass on what the process answers; None when it ends."""
    with suppress(EOFError, OSError, pickle.UnpicklingError), stream:
        while True:
            answers.put(pickle.load(stream))
    answers.put(None)


def serve() -> None:
    """The other process: settings first, then reviews, until there is nothing more to read."""
    leave_interrupts_to_parent()
    with suppress(OSError, AttributeError):
        os.nice(NICE)
    inward, outward = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what is printed by mistake is no answer
    made: Reviewed | None = None
    with suppress(EOFError, OSError):
        settings: Any = pickle.load(inward)
        while True:
            message = pickle.load(inward)
            if isinstance(message, Seen):
                made = review(message, *settings)
                answer = replace(made, learner=None)  # it is wanted up to date
            else:
                assert made is not None
                answer = made = go_on(made, message)
            pickle.dump(answer, outward)
            outward.flush()
