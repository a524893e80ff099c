"""One recording as one task, in a process of its own or on another machine."""

from __future__ import annotations

import hashlib
import json
import threading
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from onebend.errors import OnebendError, RecordingError, ResultsError, told
from onebend.extras import package
from onebend.files import publish as publishing
from onebend.files.single_file import write_file
from onebend.learning.optimizer import FitSettings
from onebend.learning.posterior import Nuisance
from onebend.pipeline import Run, learn
from onebend.progress import available_cores, end_now, interrupts_held, own_process
from onebend.record_data import record_from, to_data
from onebend.recording.entries import Recording
from onebend.recording.folder import FILE_NAME, HOMES, folder_of, read_recording
from onebend.recording.observe import ObserveSettings
from onebend.records import Array
from onebend.report.pictures import Pictures
from onebend.report.sentences import all_remarks
from onebend.report.verdict import verdict_of
from onebend.results.learned_files import LEARN_FORMAT, learned_writer, summary_of
from onebend.results.provenance import InputFile, as_data, files_of, inputs_of, provenance
from onebend.text_files import csv_rows, quoted

# Recordings of a folder, or rows of a CSV, which may state keys.

OWN = ("path", "name", "group")  # reserved columns
MOST = 1_000_000


@dataclass(frozen=True)
class Item:
    """A requested recording."""

    name: str  # unique
    folder: Path  # absolute
    group: str = ""
    stated: tuple[tuple[str, str, Any], ...] = ()  # table, key, value instead of recording.toml's
    labels: tuple[tuple[str, str], ...] = ()  # other columns and cells


def as_text(words: str) -> str:
    """`words` as every encoding has them: the bytes of a file's name that are no UTF-8 stand as their codes."""
    return words.encode("utf-8", "backslashreplace").decode("utf-8")


def items_of(source: Path, out: Path) -> tuple[Item, ...]:
    """Recordings of `source`: a CSV with `path`, or a folder at any depth except `out`. Raises `RecordingError`: none,
    a duplicate name, or an unusable column or cell."""
    if source.is_dir():
        found = _in_folder(source.resolve(), out.resolve())
        if not found:
            raise RecordingError(f"{source} holds no recording, no folder with {FILE_NAME}. Name another.")
    elif source.suffix.lower() == ".csv" or source.is_file():
        found = _in_list(source)
    else:
        raise RecordingError(f"{source} is neither a folder nor a file. Give a folder of recordings, or a CSV of them.")
    twice = [name for name, count in Counter(one.name.casefold() for one in found).items() if count > 1]
    if twice:
        raise RecordingError(f"{source}: two recordings are called {quoted(twice[0])}. Give each a name of its own.")
    if len(found) > MOST:
        raise RecordingError(f"{source}: {len(found)} recordings; at most {MOST} are learned at once. Part them.")
    return found


def _in_folder(source: Path, out: Path) -> tuple[Item, ...]:
    """By path; the first part of a longer path is the group."""
    found = []
    for file in sorted(source.rglob(FILE_NAME)):
        folder = file.parent
        if folder == out or out in folder.parents:
            continue
        inside = folder.relative_to(source)
        group = inside.parts[0] if len(inside.parts) > 1 else ""
        name = inside.as_posix() if inside.parts else folder.name
        found.append(Item(as_text(name), folder, as_text(group)))
    return tuple(found)


def _in_list(path: Path) -> tuple[Item, ...]:
    rows = list(csv_rows(path, RecordingError))
    header = [name.strip() for name in rows[0][1]] if rows else []
    if "path" not in header:
        raise RecordingError(f"{path} has no column path, which names the folder of each recording. Add it.")
    twice = [name for name, count in Counter(header).items() if name and count > 1]
    if twice:
        raise RecordingError(f"{path}: the column {quoted(twice[0])} is there twice. Remove one.")
    keys = {name: key for name in header if name not in OWN and (key := _key(name, path)) is not None}
    if len(rows) == 1:
        raise RecordingError(f"{path} has no rows. Write one for each recording.")
    return tuple(_item(path, line, header, cells, keys) for line, cells in rows[1:])


def _item(
    path: Path, line: int, header: Sequence[str], cells: Sequence[str], keys: Mapping[str, tuple[str, str]]
) -> Item:
    if len(cells) > len(header):
        raise RecordingError(f"{path}, line {line}: {len(cells)} cells under {len(header)} columns. Quote the commas.")
    by_name = {name: cell.strip() for name, cell in zip(header, cells, strict=False) if name}
    if not by_name.get("path") or "\0" in by_name["path"]:
        raise RecordingError(f"{path}, line {line}: the path is empty or no path. Name the recording's folder.")
    folder = folder_of(path.resolve().parent / by_name["path"])
    stated = tuple((*key, _value(by_name[name])) for name, key in keys.items() if by_name.get(name))
    labels = tuple((name, by_name.get(name, "")) for name in header if name and name not in OWN)
    return Item(by_name.get("name") or by_name["path"], folder, by_name.get("group", ""), stated, labels)


def _key(column: str, path: Path) -> tuple[str, str] | None:
    """Table and key that a column states, as `length_m` or `beam.length_m`; None: a label. Raises `RecordingError` if
    several tables have the key."""
    table, dot, name = column.partition(".")
    if dot:
        return (table, name) if table in HOMES.get(name, ()) else None
    homes = HOMES.get(column, ())
    if len(homes) > 1:
        raise RecordingError(
            f"{path}: the column {column} is a key of {' and '.join(f'[{home}]' for home in homes)} in {FILE_NAME}. "
            f"Write {homes[0]}.{column} for one of them, or rename a label."
        )
    return (homes[0], column) if homes else None


def _value(cell: str) -> Any:
    """A TOML value, else text."""
    if cell in ("true", "false") or cell.startswith("["):
        try:
            return tomllib.loads(f"value = {cell}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError):
            return cell
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            continue
    return cell


# Records: one small JSON file per recording, named by the hash of its inputs.

FORMAT = "onebend-batch-record-5"
LARGEST = 2**20  # bytes of a record
RECORDS = ".records"
PLACES = np.linspace(0.0, 1.0, 101)  # s
EVERY = 5  # of PLACES, for the covariance of log k


@dataclass(frozen=True)
class Record:
    """A learned recording, or the reason why it failed."""

    hash: str
    reason: str = ""  # empty: learned
    length: float = np.nan  # m
    k: Array | None = None  # (101,) N m at PLACES
    low: Array | None = None  # (101,) N m, 95 % band
    high: Array | None = None  # (101,) N m
    identified: Array | None = None
    covariance: Array | None = None  # (21, 21) of log k at every fifth of PLACES, without `gain_sd`
    prior_part: Array | None = None  # (21, 21) its part from the prior
    gain_sd: float = np.nan  # of log k, common to all recordings
    grade: str = ""
    headline: str = ""
    error: float = np.nan  # m RMS, worst tag
    doubts: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    nuisances: tuple[Nuisance, ...] = ()
    frames: int = 0
    seconds: float = np.nan
    finished: str = ""  # UTC, ISO 8601

    @property
    def in_doubt(self) -> bool:
        """Whether `onebend learn` doubts it: k(s) is not to be trusted, or identified nowhere."""
        return bool(self.doubts) or (self.identified is not None and not self.identified.any())


def hash_of(files: Iterable[Path], made_with: Mapping[str, Any]) -> str:
    """SHA-256 of contents, names and settings, the same on every machine. Raises `OSError`."""
    entries = sorted((path.name, publishing.sha256_of(path)) for path in dict.fromkeys(files))
    text = json.dumps({"files": entries, "with": made_with}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def record_of(run: Run, hashed: str, *, seconds: float, finished: str) -> Record:
    assert run.posterior is not None  # a batch uses the fit
    verdict, band = verdict_of(run), run.posterior.stiffness.band(PLACES)
    return Record(
        hash=hashed,
        length=run.beam.length,
        k=band.k,
        low=band.low,
        high=band.high,
        identified=np.asarray(band.identified),
        covariance=run.posterior.stiffness.log_covariance(PLACES[::EVERY]),
        prior_part=run.posterior.prior_part(PLACES[::EVERY]),
        gain_sd=run.posterior.stiffness.gain_sd,
        grade=verdict.grade,
        headline=verdict.headline,
        error=verdict.error,
        doubts=run.posterior.stiffness.doubts,
        warnings=tuple(remark.text for _, remark in all_remarks(run) if remark.level == "warning"),
        nuisances=tuple(run.posterior.nuisances()),
        frames=len(run.recordings[0].time),
        seconds=seconds,
        finished=finished,
    )


def record_path(out: Path, hashed: str) -> Path:
    return out / RECORDS / f"{hashed}.json"


def write_record(out: Path, record: Record) -> None:
    """Completely or not at all. Raises `ResultsError`."""
    text = json.dumps(publishing.with_checksum({"format": FORMAT, **to_data(record)}))
    write_file(record_path(out, record.hash), text + "\n", overwrite=True)


def read_record(out: Path, hashed: str) -> Record | None:
    """None if absent or changed."""
    data = publishing.read_object(record_path(out, hashed), LARGEST)
    if data is None or not publishing.is_unchanged(data) or (data.get("format"), data.get("hash")) != (FORMAT, hashed):
        return None
    return record_from(Record, {name: data[name] for name in set(data) - {"format", publishing.OWN_CHECKSUM}})


FOLDERS = "recordings"  # with `folders`


@dataclass(frozen=True)
class TaskSettings:
    """Of all tasks of a batch."""

    out: Path  # absolute
    version: str  # of the onebend that asks
    folders: bool = False
    fitting: FitSettings = field(default_factory=FitSettings)
    # other cores have their own recordings
    observing: ObserveSettings = field(default_factory=lambda: ObserveSettings(threads=1))


@dataclass(frozen=True)
class ItemResult:
    """The record itself is in the results folder."""

    hash: str  # empty: no record
    learned_now: bool  # False: the record existed
    reason: str = ""  # if there is no record


def do(item: Item, settings: TaskSettings) -> ItemResult:
    """Learns the recording unless its record exists.

    A failure is recorded with its reason, unless it may be temporary (an unreadable file, a fault of onebend).
    """
    try:
        return _do(item, settings)
    except OSError as error:
        return ItemResult("", True, f"{error.filename or item.folder}: {error.strerror or error}")
    except ResultsError as error:
        return ItemResult("", True, told(error))
    except Exception as error:  # one recording must not end thousands
        return ItemResult("", True, f"a fault of onebend: {type(error).__name__}: {error}")


def _do(item: Item, settings: TaskSettings) -> ItemResult:
    stated = {(table, key): value for table, key, value in item.stated}
    unread = ""
    recording = None
    try:
        recording = read_recording(item.folder, stated)
        files = inputs_of(files_of(recording))
    except OnebendError as error:
        unread, files = told(error), inputs_of([item.folder])
    made_with = {
        "version": settings.version,
        "stated": [[table, key, value] for table, key, value in item.stated],
        "settings": {"fit": as_data(settings.fitting), "observing": as_data(settings.observing)},
        "path": str(item.folder) if unread else "",  # the reason may name it
    }
    hashed = hash_of([one.path for one in files], made_with)
    known = read_record(settings.out, hashed)
    if known is not None and (not settings.folders or known.reason or _has_folder(item, settings.out, hashed)):
        return ItemResult(hashed, False)
    record, run = _learned(recording, unread, hashed, settings)
    changed = [one.path for one in files if not one.is_still_there()]
    if changed:
        return ItemResult("", True, f"{changed[0]} was changed while it was read. Run again to learn from it as it is")
    if settings.folders and run is not None:
        _write_folder(item, run, settings, files, hashed)
    write_record(settings.out, record)
    return ItemResult(hashed, True)


def _learned(
    recording: Recording | None, unread: str, hashed: str, settings: TaskSettings
) -> tuple[Record, Run | None]:
    """The record, and the run if it succeeded."""
    began = time.perf_counter()
    run, reason = None, unread
    if recording is not None:
        try:
            run = learn(recording, fitting=settings.fitting, observing=settings.observing)
        except ResultsError:
            raise
        except OnebendError as error:
            reason = told(error)
    seconds, now = time.perf_counter() - began, datetime.now(UTC).isoformat(timespec="seconds")
    if run is None:
        return Record(hash=hashed, reason=reason or "nothing was learned", seconds=seconds, finished=now), None
    return record_of(run, hashed, seconds=seconds, finished=now), run


def folder_path(item: Item, out: Path) -> Path:
    """Raises `ResultsError` for a name that leads elsewhere."""
    inside = Path(item.name)
    if inside.is_absolute() or ".." in inside.parts or not inside.parts:
        raise RecordingError(
            f"the name {item.name!r} is no name of a folder in the results. Give the list a column name, without .."
        )
    return out / FOLDERS / inside


def _has_folder(item: Item, out: Path, hashed: str) -> bool:
    summary = publishing.read_summary(folder_path(item, out))
    return summary is not None and summary.get("record") == hashed


def _write_folder(item: Item, run: Run, settings: TaskSettings, files: tuple[InputFile, ...], hashed: str) -> None:
    """As `onebend learn`, without pictures."""
    made_from = provenance(files, {}, {"fit": settings.fitting, "observing": settings.observing})
    summary: Mapping[str, Any] = {**summary_of(run), "record": hashed}
    write: Callable[[Path], None] = learned_writer(run, Pictures(), summary, made_from=made_from)
    with publishing.workplace(folder_path(item, settings.out), LEARN_FORMAT, overwrite=True) as place:
        publishing.publish(place, write, made_from)


# Tasks in processes of their own.

TRIES = 2  # of a recording whose process ends, as for want of memory
Work = Callable[[Item, TaskSettings], ItemResult]


def results_of(
    items: Sequence[Item], settings: TaskSettings, workers: int | None = None, work: Work = do
) -> Iterator[tuple[int, ItemResult]]:
    """Every item's number and result as they come, from `workers` processes (default: one per core); one in this
    process. A lost process costs its own recording at most."""
    count = min(workers or available_cores(), len(items))
    if count == 1:
        yield from ((i, work(item, settings)) for i, item in enumerate(items))
        return
    over, pools = threading.Event(), [own_process() for _ in range(count)]
    idle = SimpleQueue[int]()

    def result(item: Item) -> ItemResult:
        number = idle.get()
        try:
            for _ in range(TRIES):
                with suppress(BrokenExecutor):
                    return pools[number].submit(work, item, settings).result()
                if over.is_set():
                    break
                pools[number] = own_process()
        finally:
            idle.put(number)
        return ItemResult("", True, "the processes that learned from it ended: too little memory?")

    for number in range(count):
        idle.put(number)
    threads = ThreadPoolExecutor(count)
    with interrupts_held():  # threads and processes that are begun here answer to none
        futures = {threads.submit(result, item): i for i, item in enumerate(items)}
    try:
        for future in as_completed(futures):
            yield futures[future], future.result()
    finally:
        over.set()
        threads.shutdown(wait=False, cancel_futures=True)
        for pool in pools:
            end_now(pool)


# Tasks on a Dask cluster, whose machines see all folders under the same paths.

WAIT = "30s"  # for the scheduler
LOST = "the scheduler of the cluster is lost. Start it and its workers again"


def on_worker(item: Item, settings: TaskSettings) -> ItemResult:
    """`do`, by the onebend of the machine that runs it."""
    here = version("onebend")
    if here != settings.version:
        text = f"the worker has onebend {here}, but onebend {settings.version} asks. Install the same on both"
        return ItemResult("", False, text)
    return do(item, settings)


def results_on(address: str, items: Sequence[Item], settings: TaskSettings) -> Iterator[tuple[int, ItemResult]]:
    """As `results_of`, from the workers of the Dask scheduler at `address`, which repeat the tasks of lost workers.
    Raises `MissingPackageError`, or `ResultsError` if nobody answers or the scheduler is lost."""
    library = package("distributed", "batch")
    try:
        client = library.Client(address, timeout=WAIT)
    except (OSError, ValueError) as error:
        raise ResultsError(f"no scheduler answers at {address} ({error}). Start one, or correct it") from error
    with client:
        try:
            futures = {client.submit(on_worker, item, settings, pure=False): i for i, item in enumerate(items)}
            for future in library.as_completed(futures):
                yield futures[future], _of_worker(future, library)
        except (OSError, CancelledError) as error:
            raise ResultsError(LOST) from error


def _of_worker(future: Any, library: Any) -> ItemResult:
    try:
        found: ItemResult = future.result()
    except library.KilledWorker:
        return ItemResult("", True, "the workers that learned from it were lost: too little memory?")
    return found
