"""What is kept of one recording: a small JSON file, whole or not there, under the hash of all that it was made from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from onebend.files.manifest import sha256_of
from onebend.files.single_file import write_file
from onebend.pipeline import Run
from onebend.records import Array
from onebend.report.findings import all_remarks
from onebend.report.verdict import verdict_of
from onebend.strict_json import to_json

FORMAT = "onebend-batch-record-3"
RECORDS = ".records"  # in the results folder
PLACES = np.linspace(0.0, 1.0, 101)  # s, of a record's k(s)
EVERY = 5  # of PLACES: where a record has the covariance of log k


@dataclass(frozen=True)
class Record:
    """A recording that was learned, or the reason why it could not be."""

    hash: str
    reason: str = ""  # why there is no k(s); empty: there is one
    length: float = np.nan  # m
    k: Array | None = None  # (101,) N m at PLACES
    low: Array | None = None  # (101,) N m, of the 95 % band
    high: Array | None = None  # (101,) N m
    identified: Array | None = None  # (101,) bool
    covariance: Array | None = None  # (21, 21) of log k at every fifth of PLACES, without what is common to all of k
    prior_part: Array | None = None  # (21, 21) of that covariance, what comes from the prior and not from the data
    gain_sd: float = np.nan  # of log k: what the force sensor's scale does to all of k, in every recording alike
    grade: str = ""  # of the verdict
    headline: str = ""
    error: float = np.nan  # m RMS of the worst tag
    doubts: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    nuisances: tuple[tuple[str, str, float, float, float], ...] = ()  # name, unit, value, sd, prior sd
    frames: int = 0
    seconds: float = np.nan  # that reading and learning took
    finished: str = ""  # UTC, ISO 8601


def hash_of(files: Iterable[Path], made_with: Mapping[str, Any]) -> str:
    """SHA-256 over the content of the files, their names, and what they are learned with; the same on every machine.

    Raises:
        OSError: a file cannot be read.
    """
    entries = sorted((path.name, sha256_of(path)) for path in dict.fromkeys(files))
    text = json.dumps({"files": entries, "with": made_with}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def record_of(run: Run, hashed: str, *, seconds: float, finished: str) -> Record:
    """What is kept of a learned recording."""
    assert run.posterior is not None  # a batch learns with the fit
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
        nuisances=tuple((n.name, n.unit, n.value, n.sd, n.prior_sd) for n in run.posterior.nuisances()),
        frames=len(run.recordings[0].time),
        seconds=seconds,
        finished=finished,
    )


def record_path(out: Path, hashed: str) -> Path:
    """Where the record of this hash stands in the results `out`."""
    return out / RECORDS / f"{hashed}.json"


def write_record(out: Path, record: Record) -> None:
    """Put the record in place, whole or not at all. Raises `ResultsError` where it cannot be written."""
    write_file(record_path(out, record.hash), to_json({"format": FORMAT, **vars(record)}) + "\n", overwrite=True)


def read_record(out: Path, hashed: str) -> Record | None:
    """The record of this hash; None where there is none, or none that can be used: it is made anew then."""
    try:
        data = json.loads(record_path(out, hashed).read_text(encoding="utf-8"))
        if data.pop("format") != FORMAT or data["hash"] != hashed:
            return None
        curves = {name: _curve(data[name]) for name in ("k", "low", "high")}
        known = None if data["identified"] is None else np.array(data["identified"], dtype=bool)
        if any(curve is not None and curve.shape != PLACES.shape for curve in (*curves.values(), known)):
            return None
        squares = {n: None if data[n] is None else np.array(data[n], dtype=float) for n in ("covariance", "prior_part")}
        if any(one is not None and one.shape != (len(PLACES[::EVERY]),) * 2 for one in squares.values()):
            return None
        return Record(
            **data
            | curves
            | squares
            | {name: _number(data[name]) for name in ("length", "gain_sd", "error", "seconds")}
            | {name: tuple(data[name]) for name in ("doubts", "warnings")}
            | {
                "identified": known,
                "nuisances": tuple((n, unit, *map(_number, values)) for n, unit, *values in data["nuisances"]),
            }
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _curve(values: Any) -> Array | None:
    return None if values is None else np.array([_number(value) for value in values])


def _number(value: Any) -> float:
    """A number, which is null in JSON where it is not finite."""
    return np.nan if value is None else float(value)
