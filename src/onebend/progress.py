"""Progress of long work, worker processes and threads, and BLAS threads. Library calls are silent by default."""

from __future__ import annotations

import os
import platform
import signal
import struct
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, Protocol, TypeVar

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing.process import BaseProcess

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


# Processes and threads that share work: how many run at once here, who answers to an interrupt, and where what they
# make is kept.

Result = TypeVar("Result")
_WORTH_THREADS = 4  # pieces of work: for fewer, threads are not worth their start
_ORDINARY = (0, 0, 0)  # policy, priority and length of slices [ns], as `_schedule` takes them: SCHED_OTHER
_REAL_TIME = (2, 5, 0)  # SCHED_RR
_SHORT_SLICES = (0, 0, 300_000)  # SCHED_OTHER


def available_cores() -> int:
    """Cores that this process may use, 1 at least."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def each(work: Callable[..., Result], *arguments: Iterable[object]) -> tuple[Result, ...]:
    """`work` of each row of the arguments, which are equally long, in order; many rows on threads, one a core.

    For work in large arrays, most of which leaves the interpreter free.
    """
    rows = list(zip(*arguments, strict=True))
    cores = available_cores() if len(rows) >= _WORTH_THREADS else 1
    if cores == 1:
        return tuple(work(*row) for row in rows)
    from concurrent.futures import ThreadPoolExecutor  # here, as below: `--version` starts no thread

    with ThreadPoolExecutor(cores) as pool:
        return tuple(pool.map(lambda row: work(*row), rows))


@contextmanager
def interrupts_held() -> Iterator[None]:
    """An interrupt waits until the end of this block; processes and threads that are begun inside answer to none.

    A worker that is interrupted while it is being loaded, before its initialiser, would print a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # begun later, with the first process, it would let interrupts in again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def leave_interrupts_to_parent() -> None:
    """Initialiser of a worker process: interrupts are its parent's business, which ends them; so is real time."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    leave_real_time()


def leave_real_time() -> None:
    """Initialiser of a worker in a process that is in `real_time`: its work may wait."""
    _schedule(_ORDINARY, [])


@contextmanager
def real_time() -> Iterator[None]:
    """The threads of this process, and what they begin meanwhile, run as soon as they have something to do.

    Linux grants real-time scheduling to root, and to users with a limit `rtprio`. Else short slices are asked for,
    which Linux 6.12 and later grant to all. A thread that has the interpreter hands it over in a tenth of the usual
    time.
    """
    before = sys.getswitchinterval()
    urgent = _schedule(_REAL_TIME, _threads()) or _schedule(_SHORT_SLICES, _threads())
    sys.setswitchinterval(0.1 * before)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
        if urgent:
            _schedule(_ORDINARY, _threads())


def _threads() -> list[int]:
    """All of this process, as Linux numbers them."""
    return [int(one.name) for one in Path("/proc/self/task").glob("*")]


def _schedule(wanted: tuple[int, int, int], others: list[int]) -> bool:
    """Ask Linux for a policy, a priority and a length of slices [ns], for this thread and others; whether it grants
    them."""
    call_number = {"x86_64": 314, "aarch64": 274}.get(platform.machine())
    if sys.platform != "linux" or call_number is None:
        return False
    import ctypes  # here, as below: no start-up time for what never drives

    policy, priority, slice_ns = wanted
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    asked = struct.pack("=IIQiIQQQ", 48, policy, 0, nice, priority, slice_ns, 0, 0)  # struct sched_attr
    call = ctypes.CDLL(None).syscall  # sched_setattr, which neither Python nor older C libraries have
    granted = bool(call(call_number, 0, asked, 0) == 0)
    for one in others if granted else ():
        call(call_number, one, asked, 0)  # one that has just ended needs none
    return granted


def end_with_parent() -> None:
    """Initialiser of a worker process: interrupts are its parent's, and it ends when the parent is gone, however."""
    leave_interrupts_to_parent()
    from multiprocessing import parent_process

    threading.Thread(target=_end_after, args=(parent_process(),), daemon=True).start()


def own_process() -> ProcessPoolExecutor:
    """A pool of one process, begun at its first work, which ends with this one."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=end_with_parent)


def end_now(pool: ProcessPoolExecutor) -> None:
    """End the pool, whatever its processes are at. It is waited for: a pool that is just ending while the interpreter
    does may print a traceback."""
    for process in list((getattr(pool, "_processes", None) or {}).values()):
        with suppress(OSError):
            process.terminate()
    pool.shutdown(wait=True, cancel_futures=True)


def _end_after(parent: BaseProcess | None) -> None:
    if parent is not None:
        parent.join()
        os._exit(0)


# One BLAS thread for work on many small matrices, whatever the caller's setting is.
#
# The linear algebra here is batched over frames of a few dozen numbers; BLAS threads then only wait for each other (a
# clock search took eighty times longer with them on a busy machine). Threads are used where they pay: finding the
# tags. Every public function that does linear algebra is guarded. The guard costs about 10 us, inside another one
# less than 1.

Arguments = ParamSpec("Arguments")


def one_blas_thread(work: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Run a function with one BLAS thread, and put the caller's setting back."""

    @wraps(work)
    def wrapped(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with _LIMIT:
            return work(*args, **kwargs)

    return wrapped


class _Limit:
    """One BLAS thread from the first function that enters to the last that leaves, over all of Python's threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0  # guards
        self._before: dict[Any, int] = {}  # libraries and the callers' settings

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            for library in _libraries("numpy.linalg" in sys.modules, "scipy.linalg" in sys.modules):
                if library not in self._before:  # another may come with a later import
                    self._before[library] = library.get_num_threads()
                    _set(library, 1)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                for library, count in self._before.items():
                    _set(library, count)
                self._before.clear()


_LIMIT = _Limit()
_FOUND: dict[str, Any] = {}  # libraries by their file


@lru_cache
def _libraries(*_loaded: bool) -> tuple[Any, ...]:
    """The BLAS libraries of this process. NumPy and SciPy may bring one each; a search takes a millisecond."""
    from threadpoolctl import ThreadpoolController  # here: no start-up time for what computes nothing

    for library in ThreadpoolController().lib_controllers:
        if library.user_api == "blas":
            _FOUND.setdefault(library.filepath, library)
    return tuple(_FOUND.values())


def _set(library: Any, count: int) -> None:
    """Set the number of threads. threadpoolctl (3.8 and later) leaves that to the Python thread that did it first."""
    if library.get_num_threads() == count:
        return
    if (release := getattr(library, "clear_controlling_thread", None)) is not None:
        release(force=True)
    library.set_num_threads(count)
    if release is not None:
        release(force=True)
