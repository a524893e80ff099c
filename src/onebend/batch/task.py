"""One recording as one task: on any machine that sees its folder and the results folder under the same paths."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from onebend.batch.listing import Item
from onebend.batch.record import Record, hash_of, read_record, record_of, write_record
from onebend.errors import OnebendError, RecordingError, ResultsError, told
from onebend.files.manifest import read_summary
from onebend.files.publish import abandon, finish, prepare, publish
from onebend.learning.inference.stages import FitSettings
from onebend.pipeline import Run, learn
from onebend.recording.folder import read_recording
from onebend.recording.observe import ObserveSettings
from onebend.recording.toml.entries import Recording
from onebend.report.figures.pictures import Pictures
from onebend.results.learned_files import learned_writer
from onebend.results.provenance import InputFile, as_data, inputs_of, provenance
from onebend.results.recording_files import files_of
from onebend.results.summary import LEARN_FORMAT, summary_of

FOLDERS = "recordings"  # in the results folder: a folder of each, where asked for


@dataclass(frozen=True)
class TaskSettings:
    """What all recordings of a batch are learned with."""

    out: Path  # absolute
    version: str  # of the onebend that asks
    folders: bool = False  # also a results folder of each recording
    fitting: FitSettings = field(default_factory=FitSettings)
    # the other cores have recordings of their own
    observing: ObserveSettings = field(default_factory=lambda: ObserveSettings(threads=1))


@dataclass(frozen=True)
class ItemResult:
    """What a task says to who asked: the record itself stands in the results folder."""

    hash: str  # empty: there is no record
    learned_now: bool  # False: the record was there
    reason: str = ""  # why there is no record


def do(item: Item, settings: TaskSettings, *, version: str) -> ItemResult:
    """Learn from the recording, unless its record is there; write the record.

    A recording that cannot be learned from has a record with the reason. Where the reason may be another one the next
    time (a file that could not be read, a fault of onebend), there is none.

    Args:
        version: of the onebend that works here.
    """
    if version != settings.version:
        text = f"the worker has onebend {version}, but onebend {settings.version} asks. Install the same on both"
        return ItemResult("", False, text)
    try:
        return _do(item, settings)
    except OSError as error:
        return ItemResult("", True, f"{error.filename or item.folder}: {error.strerror or error}")
    except ResultsError as error:
        return ItemResult("", True, told(error))
    except Exception as error:  # one recording, whatever is wrong with it, does not end thousands
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
    """The record, and all that was learned; None where nothing could be."""
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
    """Where the results folder of one recording stands. Raises `RecordingError` where its name leads elsewhere."""
    inside = Path(item.name)
    if inside.is_absolute() or ".." in inside.parts or not inside.parts:
        raise RecordingError(
            f"the name {item.name!r} is no name of a folder in the results. Give the list a column name, without .."
        )
    return out / FOLDERS / inside


def _has_folder(item: Item, out: Path, hashed: str) -> bool:
    summary = read_summary(folder_path(item, out))
    return summary is not None and summary.get("record") == hashed


def _write_folder(item: Item, run: Run, settings: TaskSettings, files: tuple[InputFile, ...], hashed: str) -> None:
    """What `onebend learn` leaves, but for the pictures."""
    made_from = provenance(files, {}, {"fit": settings.fitting, "observing": settings.observing})
    summary: Mapping[str, Any] = {**summary_of(run, written_by=f"onebend {settings.version}"), "record": hashed}
    write: Callable[[Path], None] = learned_writer(
        run, Pictures(), summary, version=settings.version, made_from=made_from
    )
    place = prepare(folder_path(item, settings.out), kind=LEARN_FORMAT, overwrite=True)
    try:
        publish(place, write, made_from)
    except BaseException:
        abandon(place)
        raise
    finish(place)
