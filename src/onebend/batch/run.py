"""A batch from its list to its results. Stopped at any moment, the same call goes on: what has a record is done."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from onebend.batch.engine import cluster, dashboard_of, results_of
from onebend.batch.listing import Item, items_of
from onebend.batch.outcome import BatchOutcome, outcome_of
from onebend.batch.record import RECORDS, Record, read_record
from onebend.batch.task import ItemResult, TaskSettings, folder_path
from onebend.errors import ResultsError
from onebend.extras import require
from onebend.files.single_file import write_file
from onebend.files.target import check_place
from onebend.files.workplace import enter
from onebend.progress import Progress, Silent, track
from onebend.strict_json import to_json

BATCH_FORMAT = "onebend-batch-1"
MARKER = "batch.json"  # in a results folder: it is one of a batch


def run_batch(
    source: Path | str,
    out: Path | str,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    processes: bool = True,
    folders: bool = False,
    progress: Progress = Silent(),
    began: Callable[[str], None] = lambda _: None,
) -> BatchOutcome:
    """Learn from every recording of `source` (a folder, or a CSV) by itself; what is learned stands in `out`.

    Args:
        scheduler: address of a Dask scheduler whose workers see the recordings and `out` under the same paths; None:
            one on this machine.
        workers: how many, on this machine; None: one a core.
        processes: whether those are processes of their own.
        folders: also a results folder of each recording.
        began: is told the link of the cluster's page ("": none) when the work begins.

    Raises:
        RecordingError: the list cannot be used.
        MissingPackageError: Dask is not installed.
        ResultsError: `out` holds something else, or is being written; the scheduler is lost.
    """
    require(("dask", "distributed"), "batch")
    target = Path(os.path.realpath(out))
    items = items_of(Path(source), target)
    if folders:
        for item in items:
            folder_path(item, target)
    check_place(target)
    place = enter(target, BATCH_FORMAT)
    try:
        _take(target)
        settings = TaskSettings(target, version("onebend"), folders)
        with cluster(scheduler, workers, processes=processes) as client:
            began(dashboard_of(client))
            results = _all(client, items, settings, progress)
        for left in (target / RECORDS).glob(".*.json"):
            left.unlink(missing_ok=True)  # begun by workers that were lost
    finally:
        place.remove()
    records = [_record(target, item, result) for item, result in zip(items, results, strict=True)]
    return outcome_of(target, items, records, sum(one.learned_now for one in results))


def _take(out: Path) -> None:
    """Make `out` the results folder of a batch. Raises `ResultsError` where it holds anything else."""
    marker = out / MARKER
    if marker.is_file():
        return
    if out.exists() and any(out.iterdir()):
        raise ResultsError(f"{out}: holds files that are not of a batch. Choose another -o")
    write_file(marker, to_json({"format": BATCH_FORMAT, "written_by": f"onebend {version('onebend')}"}) + "\n")


def _all(client: Any, items: Sequence[Item], settings: TaskSettings, progress: Progress) -> list[ItemResult]:
    found: dict[int, ItemResult] = {}
    try:
        for i, result in track(progress, "Recordings", results_of(client, items, settings), len(items)):
            found[i] = result
    except BaseException as error:
        error.add_note(
            f"{len(found)} of {len(items)} recordings are done, and kept in {settings.out}; the same command goes on "
            "from there."
        )
        raise
    return [found[i] for i in range(len(items))]


def _record(out: Path, item: Item, result: ItemResult) -> Record:
    if not result.hash:
        return Record(hash="", reason=result.reason)
    record = read_record(out, result.hash)
    if record is None:
        raise ResultsError(
            f"{out}: the record of {item.name} is not there, though a worker wrote it. The workers of a cluster must "
            "see this folder under the same path"
        )
    return record
