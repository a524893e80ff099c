"""One BLAS thread for work on many small matrices.

The linear algebra here is batched over frames of a few dozen numbers; BLAS threads then only wait for each other (a
clock search took eighty times longer with them on a busy machine). Threads are used where they pay: finding the tags.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def one_blas_thread(work: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Run a function with one BLAS thread, and put the caller's setting back."""

    @wraps(work)
    def wrapped(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with threadpool_limits(limits=1, user_api="blas"):
            return work(*args, **kwargs)

    return wrapped
