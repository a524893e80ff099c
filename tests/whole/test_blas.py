"""One BLAS thread inside public calls, the caller's own number after them."""

from __future__ import annotations

import inspect
import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from types import ModuleType
from typing import Any

import pytest
import scipy.linalg  # noqa: F401  (its BLAS is there)
from threadpoolctl import threadpool_info, threadpool_limits

import onebend
from onebend import control
from onebend.cli import Command, all_commands
from onebend.live import OnlineLearner
from onebend.progress import one_blas_thread

COMMANDS = all_commands()

# What needs no guard: it reads or writes files, or only describes.
UNGUARDED = {
    "load_model", "load_observations", "load_uncertain", "save_model", "save_observations",
    "angles", "curve", "curve_of_length", "points", "read_goals", "read_targets", "tags",
    "simulate_trials", "trial_settings", "wrong_beams",  # each trial runs under it; the others compute next to nothing
}  # fmt: skip


BROUGHT_ALONG = re.compile(r"(numpy|scipy)\.libs|site-packages[\\/](numpy|scipy)[\\/]")


def threads() -> list[int]:
    """BLAS threads of NumPy's library and of SciPy's; other packages may bring one of their own."""
    ours = [one for one in threadpool_info() if one["user_api"] == "blas" and BROUGHT_ALONG.search(one["filepath"])]
    return [one["num_threads"] for one in ours]


@pytest.fixture
def two_threads() -> Iterator[list[int]]:
    with threadpool_limits(limits=2, user_api="blas"):
        if threads() != [2] * len(threads()):
            pytest.skip("this BLAS has no second thread")
        yield threads()


def test_one_thread_inside_and_the_callers_number_after(two_threads: list[int]) -> None:
    assert one_blas_thread(threads)() == [1] * len(two_threads)
    assert threads() == two_threads
    assert one_blas_thread(lambda: (one_blas_thread(threads)(), threads()))() == ([1] * len(two_threads),) * 2
    assert threads() == two_threads


def test_an_error_puts_it_back_too(two_threads: list[int]) -> None:
    @one_blas_thread
    def fail() -> None:
        raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011
        fail()
    assert threads() == two_threads


def test_the_last_of_several_python_threads_puts_it_back(two_threads: list[int]) -> None:
    together = Barrier(3)

    @one_blas_thread
    def meet(index: int) -> list[int]:
        together.wait(10.0)
        time.sleep(0.05 * index)
        return threads()

    with ThreadPoolExecutor(3) as pool:
        inside = list(pool.map(meet, range(3)))
    assert inside == [[1] * len(two_threads)] * 3
    assert threads() == two_threads


def test_a_public_call_works_with_one_thread(two_threads: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[int]] = []

    def probe(*_: Any, **__: Any) -> Any:
        seen.append(threads())
        raise RuntimeError

    monkeypatch.setattr("onebend.beam.model.equilibrium", probe)
    with pytest.raises(RuntimeError):
        onebend.Beam(0.15, onebend.Uniform(0.02)).equilibrium((0.0, 0.1))
    assert seen == [[1] * len(two_threads)]
    assert threads() == two_threads


def guarded(value: Any) -> bool:
    """Whether a function runs under the guard."""
    return getattr(value, "__code__", None) is one_blas_thread(lambda: None).__code__


@pytest.mark.parametrize("face", [onebend, control])
def test_every_public_verb_is_guarded(face: ModuleType) -> None:
    verbs = {name: getattr(face, name) for name in face.__all__ if inspect.isfunction(getattr(face, name))}
    assert sorted(name for name, verb in verbs.items() if not guarded(verb) and name not in UNGUARDED) == []


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        (onebend.Beam, ["equilibrium"]),
        (OnlineLearner, ["__init__", "update", "settle", "nuisances"]),
        (control.Controller, ["begin", "step", "margins"]),
    ],
)
def test_methods_that_solve_are_guarded(kind: type, names: list[str]) -> None:
    assert [name for name in names if not guarded(getattr(kind, name))] == []


def test_every_command_is_guarded() -> None:
    name = "show"
    assert guarded(inspect.unwrap(Command(name, COMMANDS[name]).loaded().callback, stop=guarded))
