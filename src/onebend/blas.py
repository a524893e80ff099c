"""One BLAS thread for work on many small matrices, whatever the caller's setting is.

The linear algebra here is batched over frames of a few dozen numbers; BLAS threads then only wait for each other (a
clock search took eighty times longer with them on a busy machine). Threads are used where they pay: finding the tags.
Every public function that does linear algebra is guarded. The guard costs about 10 us, inside another one less than 1.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def one_blas_thread(work: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Run a function with one BLAS thread, and put the caller's setting back."""

    @wraps(work)
    def wrapped(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with _LIMIT:
            return work(*args, **kwargs)

    return wrapped


class _Limit:
    """One BLAS thread from the first function that enters to the last that leaves, over all of Python's threads.

    The setting of OpenBLAS belongs to the process, so the last to leave puts it back. That of MKL belongs to one
    thread, so each thread puts its own back.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._here = threading.local()  # .depth: guards around this thread's work; .before: what it put to one
        self._threads = 0  # inside
        self._before: dict[Any, int] = {}  # libraries with one setting for the process, and that setting

    def __enter__(self) -> None:
        here = self._here.__dict__
        depth = here.get("depth", 0)
        libraries = _libraries("numpy.linalg" in sys.modules, "scipy.linalg" in sys.modules)
        if depth == 0 or len(here["before"]) < len(libraries):  # another BLAS may come with a later import
            with self._lock:
                self._threads += depth == 0
                before = here.setdefault("before", {})
                for library in libraries:
                    if library not in before:
                        before[library] = library.get_num_threads()
                        self._before.setdefault(library, before[library])
                        if before[library] != 1:
                            _set(library, 1)
        here["depth"] = depth + 1

    def __exit__(self, *_: object) -> None:
        here = self._here.__dict__
        here["depth"] -= 1
        if here["depth"]:
            return
        before = here.pop("before")
        with self._lock:
            self._threads -= 1
            for library, count in before.items():
                if count != 1 and _is_of_one_thread(library):
                    library.set_num_threads(count)
            if self._threads == 0:
                for library, count in self._before.items():
                    if count != 1 and not _is_of_one_thread(library):
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


def _is_of_one_thread(library: Any) -> bool:
    """Whether the library keeps its setting for each thread by itself."""
    return library.internal_api == "mkl" or getattr(library, "threading_layer", "") == "openmp"


def _set(library: Any, count: int) -> None:
    """Set the number of threads. threadpoolctl (3.8 and later) leaves that to the Python thread that did it first."""
    release = getattr(library, "clear_controlling_thread", _nothing)
    release(force=True)
    library.set_num_threads(count)
    release(force=True)


def _nothing(*, force: bool) -> None:
    """For a library whose threads every Python thread may set."""
