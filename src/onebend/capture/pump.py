"""Frames and samples in the order in which they come in, from a camera and a sensor that are read beside each other."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import suppress

from onebend.capture.clocks import Clock, PlayedClock
from onebend.capture.sources import CameraSource, End, ForceSource, Frame, Played, Samples

_WAIT = 0.05  # s
_PATIENCE = 6.0  # s: FFmpeg may wait as long for a picture
_MOST_PICTURES = 24  # that wait, less than a second: beyond, the camera's own buffer has to hold them

Item = Frame | Samples | End
Source = CameraSource | ForceSource


class Pump:
    """Reads a camera and, where there is one, a force sensor until it is closed."""

    def __init__(self, camera: CameraSource, force: ForceSource | None, clock: Clock) -> None:
        """Both are open already."""
        self._sources: list[Source] = [camera, *([] if force is None else [force])]
        self._clock = clock
        at_will = isinstance(clock, PlayedClock)  # else what is played comes as from a camera, by threads
        self._played = at_will and all(isinstance(source, Played) for source in self._sources)
        self._ended: set[int] = set()
        self._pictures: queue.Queue[None] = queue.Queue(_MOST_PICTURES)
        self._items: queue.SimpleQueue[tuple[Source, Item]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []
        if not self._played:
            self._threads = [threading.Thread(target=self._read, args=(one,), daemon=True) for one in self._sources]
            for thread in self._threads:
                thread.start()

    @property
    def waiting(self) -> int:
        """Pictures that came and are not taken."""
        return self._pictures.qsize()

    def __iter__(self) -> Iterator[tuple[Source, Item] | None]:
        """What comes in, with the source that it is from; None where nothing came for a while."""
        while not self._stop.is_set():
            if self._played:
                item = self._next_played()
                if item is None:
                    return
                yield item
            else:
                try:
                    source, got = self._items.get(timeout=_WAIT)
                except queue.Empty:
                    yield None
                    continue
                if isinstance(got, Frame):
                    with suppress(queue.Empty):
                        self._pictures.get_nowait()
                yield source, got

    def close(self) -> None:
        """Read no more, and wait for what still reads."""
        self._stop.set()
        for thread in self._threads:
            thread.join(timeout=_PATIENCE)

    def _next_played(self) -> tuple[Source, Item] | None:
        """Of the sources that are played the item that comes first: always in the same order."""
        left = [(i, one) for i, one in enumerate(self._sources) if i not in self._ended]
        if not left:
            return None
        i, source = min(left, key=lambda one: (one[1].due(), one[0]))  # type: ignore[union-attr]
        item = source.read(float("inf"))
        if item is None or isinstance(item, End):
            self._ended.add(i)
        return source, item if item is not None else End(f"{source.name} ended")

    def _read(self, source: Source) -> None:
        """One source, in a thread of its own."""
        while not self._stop.is_set():
            item = source.read(_WAIT)
            if item is None:
                continue
            if isinstance(item, Frame):
                while not self._stop.is_set():
                    try:
                        self._pictures.put(None, timeout=_WAIT)
                        break
                    except queue.Full:
                        continue
            self._items.put((source, item))
            if isinstance(item, End):
                return
