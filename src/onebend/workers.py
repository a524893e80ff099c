"""Processes and threads that share work: how many run at once, who answers to an interrupt, and memory left free."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.process import BaseProcess
from typing import TypeVar

Result = TypeVar("Result")
_WORTH_THREADS = 4  # pieces of work: for fewer, threads are not worth their start
_TRIM, _MAP = -1, -3  # of glibc's mallopt(3): M_TRIM_THRESHOLD, M_MMAP_THRESHOLD
_KEPT, _LARGEST = (
    1 << 30,
    32 << 20,
)  # bytes left free at the end of the heap; of an array in it, as many as glibc allows


def available_cores() -> int:
    """Cores that this process may use, 1 at least."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def each(work: Callable[..., Result], *arguments: Iterable[object]) -> tuple[Result, ...]:
    """`work` of each row of the arguments, which are equally long, in order; many rows on threads, one a core.

    For work in large arrays, most of which leaves the interpreter free.
    """
    rows = list(zip(*arguments, strict=True))
    cores = available_cores()
    if len(rows) < _WORTH_THREADS or cores == 1:
        return tuple(work(*row) for row in rows)
    with ThreadPoolExecutor(cores) as pool:
        return tuple(pool.map(lambda row: work(*row), rows))


def keep_freed_memory() -> bool:
    """Let this process keep the memory that its arrays leave free, for the next ones; whether the system can.

    Each large array would else be pages of its own, which the system clears when they are first written: batches over
    frames leave and take megabytes thousands of times. The peak of the memory stays what it is.
    """
    if sys.platform != "linux":
        return False
    library = ctypes.CDLL(None)
    if not hasattr(library, "mallopt"):
        return False
    return bool(library.mallopt(_MAP, _LARGEST) and library.mallopt(_TRIM, _KEPT))


def leave_interrupts_to_parent() -> None:
    """Initialiser of a worker process: an interrupt is its parent's business, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def end_with_parent() -> None:
    """Initialiser of a worker process: interrupts are its parent's, and it ends when the parent is gone, however."""
    leave_interrupts_to_parent()
    threading.Thread(target=_end_after, args=(multiprocessing.parent_process(),), daemon=True).start()


def _end_after(parent: BaseProcess | None) -> None:
    if parent is not None:
        parent.join()
        os._exit(0)
