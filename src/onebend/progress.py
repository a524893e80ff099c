"""What long work reports to. The command line shows it; library calls are silent unless told otherwise."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Progress(Protocol):
    """`start` names a stage and its size, `advance` counts, `done` closes the stage."""

    def start(self, stage: str, total: int | None) -> None: ...

    def advance(self, count: int = 1) -> None: ...

    def done(self) -> None: ...


class Silent:
    """A `Progress` that shows nothing."""

    def start(self, stage: str, total: int | None) -> None:
        pass

    def advance(self, count: int = 1) -> None:
        pass

    def done(self) -> None:
        pass


def track(progress: Progress, stage: str, items: Iterable[Item], total: int | None) -> Iterator[Item]:
    """Yield `items` while telling `progress`; the stage is closed even when the loop is left early."""
    progress.start(stage, total)
    try:
        for item in items:
            yield item
            progress.advance()
    finally:
        progress.done()


@dataclass
class Stopwatch:
    """A `Progress` that passes everything on and keeps the seconds of each stage, without those of stages inside it."""

    inner: Progress
    seconds: dict[str, float] = field(default_factory=dict)
    _open: list[list[float]] = field(default_factory=list)  # begin, and seconds of the stages inside
    _names: list[str] = field(default_factory=list)

    def start(self, stage: str, total: int | None) -> None:
        self._begin(stage)
        self.inner.start(stage, total)

    def advance(self, count: int = 1) -> None:
        self.inner.advance(count)

    def done(self) -> None:
        self._end()
        self.inner.done()

    @contextmanager
    def whole(self, stage: str) -> Iterator[None]:
        """Time a stage that has no steps to count."""
        self._begin(stage)
        yield
        self._end()

    def _begin(self, stage: str) -> None:
        self._names.append(stage)
        self.seconds.setdefault(": ".join(self._names).lower(), 0.0)
        self._open.append([time.perf_counter(), 0.0])

    def _end(self) -> None:
        name = ": ".join(self._names).lower()
        begin, inside = self._open.pop()
        self._names.pop()
        spent = time.perf_counter() - begin
        self.seconds[name] += spent - inside
        if self._open:
            self._open[-1][1] += spent
