"""What a batch costs a recording beside the learning itself."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from onebend.batch.run import run_batch
from onebend.batch.writing import summary_of, write_batch
from onebend.pipeline import learn
from tests.batch.stems import stem

COUNT = 50
ALONE = 5  # recordings learned without a batch, to compare with


def main(count: int = COUNT) -> None:
    """One worker, so that the seconds of the learning add up; then the same call again, when all is there."""
    with tempfile.TemporaryDirectory() as name:
        stems, out = Path(name) / "stems", Path(name) / "out"
        for i in range(count):
            stem(stems / f"group-{i % 2}" / f"stem-{i}", scale=1.0 + i % 2, seed=i)
        alone = [_timed(lambda i=i: learn(stems / f"group-{i % 2}" / f"stem-{i}")) for i in range(ALONE)]
        began = time.perf_counter()
        outcome = run_batch(stems, out, workers=1)
        whole = time.perf_counter() - began
        writing = _timed(lambda: write_batch(outcome, summary_of(outcome, written_by="a benchmark"), version="0"))
        again = _timed(lambda: run_batch(stems, out, workers=1))
        learning = float(np.sum([one.seconds for one in outcome.records]))
        size = sum(path.stat().st_size for path in out.rglob("*.json")) / count
    assert not outcome.failed
    print(f"{count} recordings of marker tracks (38 frames each), one worker process.\n")
    print("| | s |\n| --- | --- |")
    print(f"| learning, a recording, in the batch (mean) | {learning / count:.2f} |")
    print(f"| learning, a recording, alone (median of {ALONE}) | {np.median(alone):.2f} |")
    print(f"| all else, a recording: (whole run less learning) / {count} | {(whole - learning) / count:.3f} |")
    print(f"| tables and page, all together | {writing:.2f} |")
    print(f"| the same call again, whole | {again:.2f} |")
    print(f"\nA record takes {size / 1000:.0f} kB.")


def _timed(work: object) -> float:
    began = time.perf_counter()
    assert callable(work)
    work()
    return time.perf_counter() - began


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT)
