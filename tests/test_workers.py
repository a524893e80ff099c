"""Work that threads share: its order, its results to the bit, and a piece that fails."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from onebend import workers
from onebend.workers import each


def test_results_are_alike_to_the_bit_and_in_order_on_one_core_and_on_many(monkeypatch: pytest.MonkeyPatch) -> None:
    matrices, seen = np.random.default_rng(1).standard_normal((20, 40, 40)), set()

    def work(number: int, matrix: np.ndarray) -> tuple[int, np.ndarray]:
        seen.add(threading.get_ident())
        return number, np.linalg.inv(matrix) @ matrix.T

    every = []
    for cores in (1, 2, 5):
        monkeypatch.setattr(workers, "available_cores", lambda cores=cores: cores)
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
    monkeypatch.setattr(workers, "available_cores", lambda: 2)
    before = threading.active_count()

    def work(number: int) -> int:
        if number == 3:
            raise failure
        return number

    with pytest.raises(failure):
        each(work, range(10))
    assert threading.active_count() == before
