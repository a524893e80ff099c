"""Which push to make next, from all that was recorded so far: fitted and planned by a process beside this one."""

from __future__ import annotations

from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import get_context

from onebend.errors import OnebendError
from onebend.learning.design.instruments import instruments_of
from onebend.learning.design.planning import plan
from onebend.pipeline import learn_observed
from onebend.recording.observe import ObserveSettings
from onebend.streaming.review import Seen, observed_in
from onebend.workers import interrupts_held, leave_interrupts_to_parent


def next_push_words(seen: Seen, observing: ObserveSettings = ObserveSettings()) -> str:
    """The push that would leave the narrowest band without anything new on the bench, in words; else why none."""
    try:
        posterior = learn_observed(observed_in(seen, observing)).posterior
        assert posterior is not None  # it was asked for
        found = plan(posterior.stiffness, posterior.beam, instruments_of(posterior))
    except OnebendError as wrong:
        return f"what the next push should be is not known: {wrong}"
    free = [one for one in found.proposals if not one.needs]
    return free[0].text if free else "no push on this bench would narrow the band much"


class NextPush:
    """Asks for it, and looks whether it is known."""

    def __init__(self, *, beside: bool = True) -> None:
        """`beside`: False: the question is answered at once, which takes some seconds."""
        self._beside = beside
        self._pool: ProcessPoolExecutor | None = None
        self._coming: Future[str] | None = None
        self._words = ""

    @property
    def words(self) -> str:
        """The answer to the last question; empty where there is none yet."""
        if self._coming is not None and self._coming.done():
            try:
                self._words = self._coming.result()
            except Exception as wrong:  # the process was ended
                self._words = f"what the next push should be is not known: {type(wrong).__name__}"
            self._coming = None
        return self._words

    def ask(self, seen: Seen, observing: ObserveSettings) -> None:
        """From what was seen so far; a question that is under way goes on."""
        if self._coming is not None:
            return
        self._words = ""
        if not self._beside:
            self._words = next_push_words(seen, observing)
            return
        if self._pool is None:
            context = get_context("spawn")
            self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=leave_interrupts_to_parent)
        with interrupts_held():
            self._coming = self._pool.submit(next_push_words, seen, observing)

    def close(self) -> None:
        """End the process."""
        if self._pool is None:
            return
        processes = list(getattr(self._pool, "_processes", {}).values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            with suppress(OSError):
                process.terminate()
        self._pool = None
