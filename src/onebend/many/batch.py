"""A batch from its list to its results. After an interruption the same call continues; recordings with a record are
done."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import numpy as np
import pyarrow as pa

from onebend.errors import RecordingError, ResultsError
from onebend.files.publish import SUMMARY, check_place, enter, finish, headed, with_checksum
from onebend.files.single_file import as_parquet, write_file
from onebend.many import tasks
from onebend.progress import Progress, Silent, track
from onebend.records import Array
from onebend.report.page import render
from onebend.report.sentences import UNKNOWN, significant
from onebend.text_files import is_number, one_line, quoted, to_json

# The outcome of a batch.


@dataclass(frozen=True)
class BatchOutcome:
    """All recordings in the order of the list."""

    out: Path
    items: tuple[tasks.Item, ...]
    records: tuple[tasks.Record, ...]
    learned_now: int  # learned in this run

    @property
    def failed(self) -> tuple[tuple[tasks.Item, str], ...]:
        """With reasons."""
        return tuple((item, one.reason) for item, one in zip(self.items, self.records, strict=True) if one.reason)

    @property
    def learned(self) -> tuple[tuple[str, tasks.Record], ...]:
        """With k(s), by name."""
        rows = zip(self.items, self.records, strict=True)
        return tuple((item.name, one) for item, one in rows if one.k is not None)

    @property
    def in_doubt(self) -> tuple[tuple[str, str], ...]:
        """Names of the learned recordings that `onebend learn` would doubt, each with the doubts."""
        return tuple((name, "; ".join(one.doubts) or NOWHERE) for name, one in self.learned if one.in_doubt)


BATCH_FORMAT = "onebend-batch-1"
MARKER = "batch.json"  # marks a batch's results folder


def run_batch(
    source: Path | str,
    out: Path | str,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    folders: bool = False,
    progress: Progress = Silent(),
) -> BatchOutcome:
    """Learns each recording of `source` (a folder or a CSV) into `out`.

    Args:
        workers: processes; None: one per core.
        scheduler: address of a Dask scheduler, whose workers learn instead.
        folders: also write a results folder per recording.

    Raises:
        RecordingError: the list cannot be used.
        MissingPackageError: a scheduler is given, and Dask is not installed.
        ResultsError: `out` holds something else, or is being written; no scheduler answers; workers for a cluster.
    """
    if scheduler is not None and workers is not None:
        raise ResultsError("a cluster has its own workers. Give --scheduler or --workers, not both")
    target = Path(os.path.realpath(out))
    items = tasks.items_of(Path(source), target)
    if folders:
        for item in items:
            tasks.folder_path(item, target)
    check_place(target)
    place = enter(target, BATCH_FORMAT)
    try:
        _take(target)
        settings = tasks.TaskSettings(target, version("onebend"), folders)
        found = (
            tasks.results_on(scheduler, items, settings) if scheduler else tasks.results_of(items, settings, workers)
        )
        results = _all(items, settings, found, progress)
        for left in (target / tasks.RECORDS).glob(".*.json"):
            with suppress(OSError):
                left.unlink()  # of lost workers
    finally:
        finish(place)
    records = [_record(target, item, result) for item, result in zip(items, results, strict=True)]
    return BatchOutcome(target, items, tuple(records), sum(one.learned_now for one in results))


def _take(out: Path) -> None:
    """Raises `ResultsError` where `out` holds anything else."""
    marker = out / MARKER
    if marker.is_file():
        return
    if out.exists() and any(out.iterdir()):
        raise ResultsError(f"{out}: holds files that are not of a batch. Choose another -o")
    write_file(marker, to_json(headed(BATCH_FORMAT)) + "\n")


def _all(
    items: Sequence[tasks.Item],
    settings: tasks.TaskSettings,
    results: Iterable[tuple[int, tasks.ItemResult]],
    progress: Progress,
) -> list[tasks.ItemResult]:
    found: dict[int, tasks.ItemResult] = {}
    try:
        for i, result in track(progress, "Recordings", results, len(items)):
            found[i] = result
    except BaseException as error:
        error.add_note(
            f"{len(found)} of {len(items)} recordings are done, and kept in {settings.out}; the same command goes on "
            "from there."
        )
        raise
    return [found[i] for i in range(len(items))]


def _record(out: Path, item: tasks.Item, result: tasks.ItemResult) -> tasks.Record:
    if not result.hash:
        return tasks.Record(hash="", reason=result.reason)
    record = tasks.read_record(out, result.hash)
    if record is None:
        raise ResultsError(f"{out}: the record of {item.name} was removed meanwhile. Run again")
    return record


# The tables of a batch as Parquet.

LENGTH = "length_m"  # stated in the list; the table has the learned value
AT = (0, 25, 50, 75, 100)  # of PLACES, for k in the table of recordings


def recordings_table(outcome: BatchOutcome) -> pa.Table:
    """One row per recording: name, group, the list's columns, k at five places with its band, the verdict. Raises
    `RecordingError` for a column with the name of ours."""
    ours = _columns(outcome)
    labels = _labels(outcome)
    both = [name for name in labels if name in ours]
    if both:
        raise RecordingError(f"the list's column {quoted(both[0])} is one of the results'. Rename it.")
    first = {name: ours.pop(name) for name in ("name", "group")}
    return pa.table(first | labels | ours)


def curves_table(outcome: BatchOutcome) -> pa.Table:
    """One row per recording and place: `name, s, k_N_m, k_lo_N_m, k_hi_N_m, identified`, at 101 places."""
    there = outcome.learned

    def joined(name: str, kind: type) -> np.ndarray:
        return np.concatenate([np.zeros(0, kind), *(getattr(one, name) for _, one in there)]).astype(kind)

    return pa.table(
        {
            "name": _texts(name for name, _ in there for _ in tasks.PLACES),
            "s": np.tile(tasks.PLACES, len(there)),
            "k_N_m": joined("k", float),
            "k_lo_N_m": joined("low", float),
            "k_hi_N_m": joined("high", float),
            "identified": joined("identified", bool),
        }
    )


def covariances_table(outcome: BatchOutcome) -> pa.Table:
    """One row per recording and place: `name, s`, the covariance of log k with that at each of 21 places, `with_0` to
    `with_1`, and its part from the prior, `prior_with_0` to `prior_with_1`, both without `gain_sd`."""
    there, places = outcome.learned, tasks.PLACES[:: tasks.EVERY]
    columns: dict[str, Any] = {
        "name": _texts(name for name, _ in there for _ in places),
        "s": np.tile(places, len(there)),
    }
    for head, field in (("with", "covariance"), ("prior_with", "prior_part")):
        rows = np.concatenate([np.zeros((0, len(places))), *(getattr(one, field) for _, one in there)])
        columns |= {f"{head}_{s:.3g}": rows[:, i] for i, s in enumerate(places)}
    return pa.table(columns)


def nuisances_table(outcome: BatchOutcome) -> pa.Table:
    """One row per recording and nuisance: `name, nuisance, unit, value, sd, prior_sd`."""
    rows = [(name, one) for name, record in outcome.learned for one in record.nuisances]
    columns = {"name": _texts(name for name, _ in rows)}
    columns |= {"nuisance": _texts(one.name for _, one in rows), "unit": _texts(one.unit for _, one in rows)}
    for name in ("value", "sd", "prior_sd"):
        columns[name] = pa.array([getattr(one, name) for _, one in rows], pa.float64())
    return pa.table(columns)


def _texts(words: Iterable[str]) -> pa.Array:
    return pa.array([tasks.as_text(one) for one in words], pa.string())


def _columns(outcome: BatchOutcome) -> dict[str, Any]:
    items, records = outcome.items, outcome.records
    found: dict[str, Any] = {
        **{name: _texts(getattr(one, name) for one in items) for name in ("name", "group")},
        **{name: _texts(getattr(one, name) for one in records) for name in ("reason", "grade")},
        **{name: _texts("; ".join(getattr(one, name)) for one in records) for name in ("doubts", "warnings")},
        LENGTH: np.array([one.length for one in records]),
    }
    for i in AT:
        for name, field in (("k", "k"), ("k_lo", "low"), ("k_hi", "high")):
            curves = [getattr(one, field) for one in records]
            found[f"{name}_at_{tasks.PLACES[i]:g}_N_m"] = np.array(
                [np.nan if one is None else one[i] for one in curves]
            )
    return found | {
        "identified": np.array([np.nan if one.identified is None else one.identified.mean() for one in records]),
        "gain_sd": np.array([one.gain_sd for one in records]),
        "error_m": np.array([one.error for one in records]),
        "frames": np.array([one.frames for one in records], dtype=np.int64),
        "seconds": np.array([one.seconds for one in records]),
        "finished": _texts(one.finished for one in records),
        "hash": _texts(one.hash for one in records),
        "path": _texts(str(item.folder) for item in items),
    }


def _labels(outcome: BatchOutcome) -> dict[str, pa.Array]:
    rows: Sequence[Mapping[str, str]] = [dict(item.labels) for item in outcome.items]
    names = rows[0] if rows else ()
    return {name: _column([row.get(name, "") for row in rows]) for name in names if name != LENGTH}


def _column(cells: Sequence[str]) -> pa.Array:
    filled = [cell for cell in cells if cell]
    if filled and all(is_number(cell) for cell in filled):
        return pa.array([float(cell) if cell else float("nan") for cell in cells], pa.float64())
    return pa.array(cells, pa.string())


# The answer of a batch, one row per recording: k at s = 0.5 with its band, where k is identified, the verdict.

MIDDLE = 50  # of PLACES
NOT_LEARNED, NOWHERE = "not learned", "identified nowhere"


@dataclass(frozen=True)
class Answer:
    """Of one recording; NaN where nothing was learned."""

    name: str
    group: str
    k: float  # N m at s = 0.5
    low: float  # N m, of the 95 % band
    high: float  # N m
    told: bool  # k is identified there
    identified: float  # share of s
    verdict: str
    warnings: int
    report: str  # address of the recording's report relative to `index.html`, or empty

    @property
    def k_words(self) -> str:
        """In brackets where k is not identified."""
        words = known(self.k)
        return words if self.told or not np.isfinite(self.k) else f"({words})"

    @property
    def identified_words(self) -> str:
        return f"{100.0 * self.identified:.0f} %" if np.isfinite(self.identified) else UNKNOWN


def answers(outcome: BatchOutcome) -> list[Answer]:
    return [_answer(outcome.out, item, one) for item, one in zip(outcome.items, outcome.records, strict=True)]


def _answer(out: Path, item: tasks.Item, one: tasks.Record) -> Answer:
    k, low, high = (np.nan if curve is None else float(curve[MIDDLE]) for curve in (one.k, one.low, one.high))
    told = one.identified is not None and bool(one.identified[MIDDLE])
    share = np.nan if one.identified is None else float(one.identified.mean())
    verdict = NOT_LEARNED if one.k is None else one.grade if one.doubts or share else NOWHERE
    report = PurePosixPath(tasks.FOLDERS, item.name, "report.html")
    there = one.k is not None and (out / report).is_file()
    address = quote(str(report)) if there else ""
    return Answer(item.name, item.group, k, low, high, told, share, verdict, len(one.warnings), address)


def known(value: float) -> str:
    """With a dash for an unknown number."""
    return significant(value) if np.isfinite(value) else UNKNOWN


# `index.html`: the answers, doubts, small pictures of k(s).

WIDE, HIGH = 100.0, 60.0  # of a small picture
STEP = 4  # of PLACES, in small pictures


def page(outcome: BatchOutcome) -> str:
    least, most = _range(outcome.records)
    names = sorted({item.group for item in outcome.items})
    rows = answers(outcome)
    content = {
        "title": one_line(f"Batch {outcome.out.name}"),
        "cards": [
            ("learned", f"{len(outcome.learned)} of {len(outcome.records)}", "recordings"),
            ("in doubt", str(len(outcome.in_doubt)), "k(s) is not to be trusted, or not known"),
        ],
        "grouped": any(names),
        "answers": [{"name": one_line(one.name), "group": one_line(one.group), "one": one} for one in rows],
        "known": known,
        "reports": any(one.report for one in rows),
        "reasons": _reasons(outcome),
        "groups": [one for name in names if (one := _group(outcome, name, least, most))["pictures"]],
        "least": significant(least),
        "most": significant(most),
        "data": "{}",
    }
    return render("onebend.many", "batch.html", {}, content, scripts=("sort.js",))


def _reasons(outcome: BatchOutcome) -> list[dict[str, Any]]:
    """Names and reasons under their headings; no heading without a name."""
    warned = [(name, text) for name, one in outcome.learned for text in one.warnings]
    kinds = {
        "In doubt": outcome.in_doubt,
        "Not learned": [(item.name, why) for item, why in outcome.failed],
        "Warnings": warned,
    }
    return [
        {"title": title, "rows": [(one_line(name), one_line(" ".join(why.split()))) for name, why in rows]}
        for title, rows in kinds.items()
        if rows
    ]


def _range(records: Sequence[tasks.Record]) -> tuple[float, float]:
    """k [N m] of all curves, and of bands up to a factor of two."""
    curves = [one.k for one in records if one.k is not None]
    if not curves:
        return 1.0, 10.0
    every = np.concatenate(curves)
    return float(every.min()) / 2.0, float(every.max()) * 2.0


def _group(outcome: BatchOutcome, name: str, least: float, most: float) -> dict[str, Any]:
    pictures = []
    for item, one in zip(outcome.items, outcome.records, strict=True):
        if item.group != name or one.k is None or one.low is None or one.high is None:
            continue
        s = tasks.PLACES[::STEP]
        band = [*_points(s, one.low[::STEP], least, most), *_points(s, one.high[::STEP], least, most)[::-1]]
        curve = _points(s, one.k[::STEP], least, most)
        pictures.append({"name": one_line(item.name), "band": " ".join(band), "curve": " ".join(curve)})
    return {"name": one_line(name), "pictures": pictures}


def _points(s: Array, k: Array, least: float, most: float) -> list[str]:
    share = np.clip(np.log(k / least) / np.log(most / least), 0.0, 1.0)
    return [f"{WIDE * x:.4g},{HIGH * (1.0 - y):.4g}" for x, y in zip(s, share, strict=True)]


def summary_of(outcome: BatchOutcome) -> dict[str, Any]:
    return headed(BATCH_FORMAT) | {
        "recordings": len(outcome.items),
        "learned": len(outcome.learned),
        "worked_on_now": outcome.learned_now,
        "failed": [{"name": item.name, "reason": why} for item, why in outcome.failed],
        "in_doubt": [{"name": name, "reason": why} for name, why in outcome.in_doubt],
    }


def write_batch(outcome: BatchOutcome, summary: dict[str, Any]) -> None:
    """Writes tables, page and summary, which lists them by checksum. Raises `RecordingError`: a column has the name of
    one of ours. Raises `ResultsError`: a file cannot be written."""
    made = {
        "recordings.parquet": as_parquet(recordings_table(outcome)),
        "curves.parquet": as_parquet(curves_table(outcome)),
        "covariances.parquet": as_parquet(covariances_table(outcome)),
        "nuisances.parquet": as_parquet(nuisances_table(outcome)),
        "index.html": page(outcome).encode(),
    }
    files = {name: hashlib.sha256(content).hexdigest() for name, content in made.items()}
    listed = with_checksum(json.loads(to_json({**summary, "files": {**files, SUMMARY: None}})))
    for name, content in {**made, SUMMARY: to_json(listed).encode() + b"\n"}.items():
        write_file(outcome.out / name, content, overwrite=True)
