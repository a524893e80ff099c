"""Work that threads share: its order, its results to the bit, a piece that fails; arrays in pages of their own."""

from __future__ import annotations

import mmap
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from onebend import progress
from onebend.learning.normal import in_own_pages
from onebend.progress import each, leave_interrupts_to_parent, leave_real_time, real_time


def test_results_are_alike_to_the_bit_and_in_order_on_one_core_and_on_many(monkeypatch: pytest.MonkeyPatch) -> None:
    matrices, seen = np.random.default_rng(1).standard_normal((20, 40, 40)), set()

    def work(number: int, matrix: np.ndarray) -> tuple[int, np.ndarray]:
        seen.add(threading.get_ident())
        return number, np.linalg.inv(matrix) @ matrix.T

    every = []
    for cores in (1, 2, 5):
        monkeypatch.setattr(progress, "available_cores", lambda cores=cores: cores)
        seen.clear()
        every.append(each(work, range(20), matrices))
        assert (seen == {threading.get_ident()}) == (cores == 1)
    for one in every[1:]:
        assert [number for number, _ in one] == list(range(20))
        assert all(np.array_equal(a, b) for (_, a), (_, b) in zip(every[0], one, strict=True))


@pytest.mark.parametrize("failure", [ValueError, KeyboardInterrupt])
def test_a_piece_that_fails_ends_all_and_leaves_no_thread(
    failure: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "available_cores", lambda: 2)
    before = threading.active_count()

    def work(number: int) -> int:
        if number == 3:
            raise failure
        return number

    with pytest.raises(failure):
        each(work, range(10))
    assert threading.active_count() == before


POOL = """
import multiprocessing, sys, time
from concurrent.futures import ProcessPoolExecutor
from onebend.progress import end_now
if __name__ == "__main__":
    pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
    if sys.argv[1] != "unused":
        pool.submit(time.sleep, 600.0)
    if sys.argv[1] == "working":
        pool.submit(abs, 1)
        time.sleep(1.0)
    end_now(pool)
"""


@pytest.mark.parametrize("state", ["unused", "beginning", "working"])
def test_a_pool_ends_now_and_without_a_word(tmp_path: Path, state: str) -> None:
    (tmp_path / "pool.py").write_text(POOL)
    line = [sys.executable, str(tmp_path / "pool.py"), state]
    done = subprocess.run(line, capture_output=True, text=True, timeout=120.0, check=True)
    assert done.stderr == ""


@pytest.mark.parametrize("turned", [False, True])
def test_a_large_array_is_copied_as_it_is_to_pages_that_go_with_it(turned: bool) -> None:
    array = np.random.default_rng(1).standard_normal((400, 300))
    array = array.T if turned else array
    out = in_own_pages(array)
    np.testing.assert_array_equal(out, array)
    assert out.flags.f_contiguous == array.flags.f_contiguous
    assert not np.shares_memory(out, array)
    base: object = out
    while isinstance(base, np.ndarray):
        base = base.base
    assert isinstance(base.obj if isinstance(base, memoryview) else base, mmap.mmap)
    out[0, 0] = 7.0
    assert out[0, 0] == 7.0


def test_a_small_array_stays_where_it_is() -> None:
    array = np.zeros((100, 100))
    assert in_own_pages(array) is array


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="no real time here")
def test_real_time_ends_with_its_block_and_workers_have_none() -> None:
    before, mine = os.sched_getscheduler(0), signal.getsignal(signal.SIGINT)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
        os.sched_setscheduler(0, before, os.sched_param(0))
        granted = os.SCHED_RR
    except PermissionError:
        granted = before
    with real_time():
        assert os.sched_getscheduler(0) == granted
        begun: list[int] = []
        thread = threading.Thread(target=lambda: begun.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
        assert begun == [granted]
    assert os.sched_getscheduler(0) == before
    with real_time():
        leave_interrupts_to_parent()
        assert os.sched_getscheduler(0) == before
    signal.signal(signal.SIGINT, mine)


@pytest.mark.skipif(not Path("/proc/self/sched").exists(), reason="no slices to be seen here")
def test_without_real_time_slices_are_short(monkeypatch: pytest.MonkeyPatch) -> None:
    def slice_ns() -> int:
        lines = Path("/proc/self/sched").read_text(encoding="utf-8").splitlines()
        return next((int(line.split()[-1]) for line in lines if line.startswith("se.slice")), 0)

    if not slice_ns():
        pytest.skip("this Linux has no slices")
    monkeypatch.setattr(progress, "_REAL_TIME", (2, 1000, 0))  # a priority that is not granted
    before, interval = slice_ns(), sys.getswitchinterval()
    with real_time():
        assert slice_ns() < 0.5 * before
        assert sys.getswitchinterval() < interval
        leave_real_time()
        assert slice_ns() == before
    assert slice_ns() == before
    assert sys.getswitchinterval() == interval


MASKED = """
import multiprocessing, os, signal
from onebend.progress import interrupts_held
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # work begun in the background may be deaf to it
    try:
        with interrupts_held():
            os.kill(os.getpid(), signal.SIGINT)
            pool = multiprocessing.get_context("spawn").Pool(1)
    except KeyboardInterrupt:
        found = pool.apply(signal.pthread_sigmask, (signal.SIG_BLOCK, ()))
        print(signal.SIGINT in found, signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()))
        pool.terminate()
"""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no masks of signals here")
def test_an_interrupt_waits_until_workers_are_begun_and_does_not_reach_them() -> None:
    ended = subprocess.run([sys.executable, "-c", MASKED], capture_output=True, text=True, check=False)
    assert (ended.stdout, ended.stderr) == ("True False\n", "")
