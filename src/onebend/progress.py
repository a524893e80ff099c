"""What long work reports to. The command line shows it; library calls are silent unless told otherwise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
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
