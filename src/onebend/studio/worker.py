"""The process of a job: `python -m onebend.studio.worker`, with one JSON object on standard input.

It carries out the "command" of that object in its "folder", with the settings that the command takes, and tells what
comes of it as JSON lines on standard output. Lines on standard input are a person's words meanwhile.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Event
from typing import Any, BinaryIO, TextIO

from onebend.cli import Command, all_commands
from onebend.errors import OnebendError
from onebend.text_files import to_json

OFTEN = 0.2  # s between states
_STAGES_OFTEN = 0.1  # s between lines of one stage
_PATIENCE = 3.0  # s for the last messages
ROOMS = {"learn": "learner", "check": "recordings", "loop": "looping", "drive": "driving", "record": "recorder"}


class Studio:
    """The other end: it is told lines, also as the `Listener` of a command, and says words."""

    def __init__(self, out: TextIO, said: BinaryIO) -> None:
        self.out, self.said, self._one = out, said, threading.Lock()
        self._stack: list[list[Any]] = []  # stage, done, total
        self._told = 0.0
        self.gone = Event()

    def tell(self, data: Mapping[str, Any]) -> None:
        """A line; the reader may be gone."""
        with self._one, suppress(OSError, ValueError):
            self.out.write(to_json(data, ascii_only=True, readable=False) + "\n")
            self.out.flush()

    def found(self, data: Mapping[str, Any]) -> None:
        """A result."""
        self.tell({"found": data})

    def start(self, stage: str, total: int | None = None) -> None:
        self._stack.append([stage, 0, total])
        self._tell_stage()

    def advance(self, count: int = 1) -> None:
        self._stack[-1][1] += count
        if time.monotonic() - self._told > _STAGES_OFTEN:
            self._tell_stage()

    def done(self) -> None:
        self._tell_stage()
        self._stack.pop()

    def _tell_stage(self) -> None:
        self._told = time.monotonic()
        self.tell(dict(zip(("stage", "done", "total"), self._stack[-1], strict=True)))

    def published(self) -> None:
        self.tell({"published": True})

    def obeyed(self, end: Callable[[], None], **words: Event) -> None:
        """Sets the event of each word as it is said; `end` when the studio is gone."""

        def obey() -> None:
            while line := self.said.readline():
                if (word := words.get(line.decode("utf-8", "replace").strip())) is not None:
                    word.set()
            self.gone.set()
            end()

        threading.Thread(target=obey, daemon=True).start()

    @contextmanager
    def watching(self, said: Callable[[Any, Any], Mapping[str, Any]]) -> Iterator[Callable[[Any], None]]:
        """Takes states and tells the newest in a thread of its own, the last for certain, so that a slow studio never
        delays the work. `said`: a state as a line, from it and the one told before (None: the first)."""
        newest: list[Any] = [None]
        new, over = Event(), Event()

        def tell_states() -> None:
            told, last = None, False
            while not last:
                new.wait()
                new.clear()
                last, state = over.is_set(), newest[0]
                if state is not told:
                    self.tell(said(state, told))
                    told = state
                over.wait(OFTEN)

        def watch(state: Any) -> None:
            newest[0] = state
            new.set()

        thread = threading.Thread(target=tell_states, daemon=True)
        thread.start()
        try:
            yield watch
        finally:
            over.set()
            new.set()
            thread.join(_PATIENCE)


def main() -> int:
    """0: done; 2: failed; 130: interrupted."""
    studio = Studio(os.fdopen(os.dup(1), "w"), os.fdopen(os.dup(0), "rb", buffering=0))
    nothing = os.open(os.devnull, os.O_RDWR)
    for handle in (0, 1):  # child processes must not hold the studio's pipes
        os.dup2(nothing, handle)
    wanted = json.loads(studio.said.readline())
    os.chdir(wanted["folder"])
    sys.argv = shlex.split(wanted["command"])  # for provenance
    _, name, *words = sys.argv
    try:
        given = Command(name, all_commands()[name]).given(words)
        import_module(f"onebend.studio.{ROOMS[name]}").work(studio, **given)  # here: a room loads what it needs alone
    except OnebendError as error:
        studio.tell({"error": str(error)})
        return 2
    except KeyboardInterrupt:
        studio.tell({"error": "Stopped."})
        return 130
    return 0


def end() -> None:
    """Of a process that is nothing without the studio."""
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
