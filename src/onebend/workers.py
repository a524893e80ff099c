"""Processes and threads that share work: how many run at once here, who answers to an interrupt, and where what they
make is kept."""

from __future__ import annotations

import mmap
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Result = TypeVar("Result")
_WORTH_THREADS = 4  # pieces of work: for fewer, threads are not worth their start
_WORTH_PAGES = 1 << 19  # bytes: a smaller array stays where it is


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


def in_own_pages(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """An array that stays for long, copied to memory pages of its own where it is large: they go back with it.

    The heap grows by what is made and freed around an array that stays, and cannot shrink past it. Of a hundred
    recordings learned together that was a third of the memory.
    """
    if array.nbytes < _WORTH_PAGES:
        return array
    rows = array.T if array.flags.f_contiguous else array
    out = np.frombuffer(_pages(array.nbytes), dtype=array.dtype).reshape(rows.shape)
    out[...] = rows
    return out.T if array.flags.f_contiguous else out


def _pages(count: int) -> mmap.mmap:
    """So many bytes, of this process alone."""
    if hasattr(mmap, "MAP_PRIVATE"):
        return mmap.mmap(-1, count, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    return mmap.mmap(-1, count)


@contextmanager
def interrupts_held() -> Iterator[None]:
    """An interrupt waits until the end of this block; processes and threads that are begun inside answer to none.

    A worker that is interrupted while it is being loaded, before its initialiser, would print a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # begun later, with the first process, it would let interrupts in again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
