"""Tasks on Dask: a cluster on this machine, or any by its address. Results do not depend on which."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib.metadata import version
from importlib.util import find_spec
from logging import getLogger
from typing import Any
from uuid import uuid4

from onebend.batch.listing import Item
from onebend.batch.task import ItemResult, TaskSettings, do
from onebend.errors import ResultsError
from onebend.extras import package
from onebend.workers import available_cores, interrupts_held, leave_interrupts_to_parent

ANY_PORT = "127.0.0.1:0"  # of the cluster's own page, so that two batches on one machine do not meet
WAIT = "30s"  # for a scheduler to answer
Work = Callable[[Item, TaskSettings], ItemResult]
LOST = "the scheduler of the cluster is lost. Start it and its workers again"


def distributed() -> Any:
    """Dask's library for clusters. Raises `MissingPackageError` where it is not installed."""
    # what a worker says of its own end is nothing that a person can act on: the row of the recording says it
    package("dask", "batch").config.set({"distributed.logging": {"distributed": "critical"}})
    return package("distributed", "batch")


@contextmanager
def cluster(address: str | None = None, workers: int | None = None, *, processes: bool = True) -> Iterator[Any]:
    """A client of the scheduler at `address`, or of one here with `workers` of one thread each (default: one a core).

    Raises:
        MissingPackageError: Dask is not installed.
        ResultsError: nobody answers at the address.
    """
    library = distributed()
    if address is not None:
        try:
            client = library.Client(address, timeout=WAIT)
        except (OSError, ValueError) as error:
            raise ResultsError(f"no scheduler answers at {address} ({error}). Start one, or correct it") from error
        try:
            yield client
        finally:
            client.close()
        return
    count = workers or available_cores()
    with interrupts_held():
        begun = library.LocalCluster(
            n_workers=count, threads_per_worker=1, processes=processes, dashboard_address=ANY_PORT, memory_limit=0
        )
    with begun as local, library.Client(local) as client:
        if processes:
            client.register_plugin(_prepared(library))
        yield client


def _prepared(library: Any) -> Any:
    """A plugin for workers here, those that take the place of lost ones included."""

    class Prepared(library.WorkerPlugin):  # type: ignore[misc]
        name = "onebend"

        def setup(self, worker: Any) -> None:  # noqa: ARG002
            leave_interrupts_to_parent()
            getLogger("distributed").setLevel("CRITICAL")

    return Prepared()


def dashboard_of(client: Any) -> str:
    """The link of the cluster's page; empty where it has none."""
    return str(client.dashboard_link or "") if find_spec("bokeh") else ""


def here(item: Item, settings: TaskSettings) -> ItemResult:
    """`task.do` by the onebend of the machine that this runs on."""
    return do(item, settings, version=version("onebend"))


def results_of(
    client: Any, items: Sequence[Item], settings: TaskSettings, work: Work = here
) -> Iterator[tuple[int, ItemResult]]:
    """Every item's number and result, as they come. A task whose worker is lost goes to another one.

    Raises:
        ResultsError: the scheduler is lost.
    """
    library, batch = distributed(), uuid4().hex
    futures = {}
    try:
        for i, item in enumerate(items):
            key = f"onebend-{batch}-{i}"
            futures[client.submit(work, item, settings, key=key, pure=False)] = i
        for future in library.as_completed(futures):
            yield futures[future], _result(future, library)
    except (OSError, CancelledError) as error:
        raise ResultsError(LOST) from error
    finally:
        if client.status == "running":
            client.cancel(list(futures), force=True)


def _result(future: Any, library: Any) -> ItemResult:
    if future.status == "finished":
        found: ItemResult = future.result()
        return found
    if future.status == "error":
        error = future.exception()
        if isinstance(error, library.KilledWorker):
            return ItemResult("", True, "the workers that learned from it were lost: too little memory?")
        return ItemResult("", True, f"the worker could not begin: {type(error).__name__}: {error}")
    raise ResultsError(LOST)
