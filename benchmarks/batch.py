"""What a batch costs beside the learning itself, and how far its queue goes."""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from onebend.many.batch import BatchOutcome, run_batch, summary_of, write_batch
from onebend.many.tasks import Item, ItemResult, TaskSettings, results_of
from onebend.pipeline import learn
from tests.many.stems import stem

COUNT = 60  # recordings that are learned
QUEUES = (1_000, 10_000)
Found = TypeVar("Found")


def main(count: int = COUNT) -> None:
    """The tables of the page."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rng = np.random.default_rng(0)
        for i in range(count):
            stem(folder / "stems" / f"stem-{i}", scale=float(np.exp(0.1 * rng.standard_normal())), seed=i)
        overhead(folder, count)
        everything(folder, count)
    queue()


def overhead(folder: Path, count: int) -> None:
    """One worker process, so that the seconds of the learning add up; each recording also without a batch."""
    out, names = folder / "out", [f"stem-{i}" for i in range(count)]
    learn(folder / "stems" / names[0])  # what is loaded once
    alone = np.array([timed(learn, folder / "stems" / one)[0] for one in names])
    spent, outcome = timed(run_batch, folder / "stems", out, workers=1)
    learning = np.array([one.seconds for one in outcome.records])
    assert not outcome.failed
    writing, _ = timed(write, outcome)
    size = sum(path.stat().st_size for path in out.rglob("*.json")) / count
    of = {item.name: one.seconds for item, one in zip(outcome.items, outcome.records, strict=True)}
    pairs = np.array([of[one] for one in names]) - alone
    rest = (spent - learning.sum()) / count
    print("## Beside the learning\n")
    print(f"{count} recordings of marker tracks (38 frames each), in this process.\n")
    print("| | s |\n| --- | --- |")
    print(f"| reading and learning a recording, in the batch: mean | {learning.mean():.2f} |")
    print(f"| the same recording in the batch less alone: median of {count} pairs | {np.median(pairs):+.2f} |")
    print(f"| all else, a recording: (run less learning) / {count} | {rest:.3f} |")
    print(f"| tables and page, once | {writing:.2f} |")
    print(f"\nA record takes {size / 1000:.0f} kB.\n")


def everything(folder: Path, count: int) -> None:
    """The whole command where every record is there: what is left of it is files, hashes, queue, tables and page."""
    print("## Records that are there\n")
    print(f"A list that names the {count} learned recordings again and again; two worker processes.\n")
    print("| rows | s a row, hashing and queue | tables and page [s] | index.html [MB] | memory of the command [MB] |")
    print("| --- | --- | --- | --- | --- |")
    for rows in QUEUES:
        lines = [f"stems/stem-{i % count},row-{i},g{i % 20}" for i in range(rows)]
        (folder / "list.csv").write_text("path,name,group\n" + "\n".join(lines) + "\n")
        spent, outcome = timed(run_batch, folder / "list.csv", folder / "out", workers=2)
        assert outcome.learned_now == 0
        writing, _ = timed(write, outcome)
        page = (folder / "out" / "index.html").stat().st_size / 1e6
        print(f"| {rows} | {spent / rows:.4f} | {writing:.1f} | {page:.1f} | {memory():.0f} |")
    print()


def queue() -> None:
    """Tasks that do nothing: what the processes take."""
    print("## The queue alone\n")
    print("Tasks that do nothing, two worker processes.\n")
    print("| tasks | s a task | memory of the command before, at its most [MB] | s until the first is done |")
    print("| --- | --- | --- | --- |")
    settings = TaskSettings(Path("/nowhere"), "0")
    for count in QUEUES:
        items = [Item(f"dry/stem-{i}", Path(f"/data/stems/dry/stem-{i}"), "dry") for i in range(count)]
        before, most, first = now(), 0.0, 0.0
        began = time.perf_counter()
        seen = set()
        for i, result in results_of(items, settings, 2, nothing):
            assert result.hash == "done"
            first = first or time.perf_counter() - began
            seen.add(i)
            if len(seen) % 100 == 0:
                most = max(most, now())
        spent = time.perf_counter() - began
        assert seen == set(range(count))
        print(f"| {count} | {spent / count:.4f} | {before:.0f}, {most:.0f} | {first:.1f} |")
    print()


def nothing(item: Item, settings: TaskSettings) -> ItemResult:  # noqa: ARG001
    """In place of the learning."""
    return ItemResult("done", False)


def write(outcome: BatchOutcome) -> None:
    write_batch(outcome, summary_of(outcome))


def timed(work: Callable[..., Found], *arguments: object, **options: object) -> tuple[float, Found]:
    began = time.perf_counter()
    found = work(*arguments, **options)
    return time.perf_counter() - began, found


def now() -> float:
    """Memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def memory() -> float:
    """Its largest so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def _options(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT, help="recordings that are learned")
    return int(parser.parse_args(words).count)


if __name__ == "__main__":
    main(_options())
