"""Work on many items in processes of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import TypeVar

from onebend.progress import end_now, interrupts_held, leave_interrupts_to_parent

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_processes(work: Callable[[Item], Result], items: Sequence[Item], count: int) -> Iterator[Result]:
    """`work` of each item as it is done, in up to `count` processes; a failure or an early end ends them all."""
    if min(count, len(items)) <= 1:
        yield from map(work, items)
        return
    with interrupts_held():
        pool = ProcessPoolExecutor(
            min(count, len(items)), mp_context=get_context("spawn"), initializer=leave_interrupts_to_parent
        )
        waiting = [pool.submit(work, item) for item in items]
    try:
        yield from (future.result() for future in as_completed(waiting))
    finally:
        end_now(pool)
