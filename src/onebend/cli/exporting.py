"""The command that writes a learned beam for other software."""

from __future__ import annotations

from pathlib import Path

from onebend.cli import common
from onebend.cli.models import read_trusted
from onebend.errors import ExportError
from onebend.export.export import KINDS, TABLES, Kind, export, without
from onebend.export.sample import RodSample, drawn
from onebend.files.publish import SUMMARY
from onebend.files.single_file import write_files
from onebend.results.model import StoredModel, model_file, sample_of_model
from onebend.text_files import read_json


def export_command(
    model: Path,
    *,
    to: Kind,
    output: Path | None = None,
    hinges: int | None = None,
    mass: float | None = None,
    damping_time: float | None = None,
    samples: int | None = None,
    seed: int = 0,
    overwrite: bool = False,
) -> None:
    stored = read_trusted(model)
    path = output or Path(f"beam{KINDS[to].suffix}")
    sites = () if stored.origin is None else stored.origin.marker_s
    told = _told(model, stored)
    rod = sample_of_model(stored, mass=mass, damping_time=damping_time, sites=sites, told=told)
    draws = () if samples is None else drawn(rod, samples, seed=seed)
    files = _files(path, to, rod, draws, hinges)
    write_files(files, overwrite=overwrite)
    first, *more = files
    common.say(f"Wrote {first}{f' and {len(more)} more' if more else ''}: {KINDS[to].says}.")
    for sentence in without(rod, to):
        common.say(sentence)
    common.say(KINDS[to].use.format(path=first))


def _files(
    path: Path, to: Kind, rod: RodSample, draws: tuple[RodSample, ...], hinges: int | None
) -> dict[Path, str | bytes]:
    """The files to write: one for each draw, or a table with a column for each."""
    if to == "sheet":
        if draws:
            raise ExportError("a sheet shows the band; samples go to a table (csv) or to a simulator's files")
        return {path: export(rod, to), path.with_suffix(".csv"): export(rod, "csv")}
    if not draws or to in TABLES:
        return {path: export(rod, to, hinges=hinges, samples=draws)}
    digits = len(str(len(draws)))
    names = (path.with_name(f"{path.stem}-{i:0{digits}d}{path.suffix}") for i in range(1, len(draws) + 1))
    return {name: export(one, to, hinges=hinges) for name, one in zip(names, draws, strict=True)}


def _told(model: Path, stored: StoredModel) -> tuple[tuple[str, str], ...]:
    """How the beam was measured, and how far to trust it, for the sheet."""
    told: list[tuple[str, str]] = []
    if stored.origin is not None:
        told.append(
            ("measured", f"{stored.origin.recording}, {len(stored.origin.marker_s)} tags, {stored.origin.method}")
        )
    if stored.bench is not None:
        pushes = (f"{push.largest:.3g} N at s = {push.at_s:.3g}" for push in stored.bench.pushes)
        told.append(("pushed with", ", ".join(dict.fromkeys(pushes))))
    doubts = () if stored.uncertain is None else stored.uncertain.doubts
    summary = model_file(model).with_name(SUMMARY)
    if doubts or stored.changed or stored.swapped:
        words = (
            "; ".join(doubts),
            stored.changed and f"the file {stored.changed}",
            stored.swapped and f"it {stored.swapped}",
        )
        told.append(("verdict", f"NOT TO BE TRUSTED: {'; '.join(filter(None, words))}"))
    elif summary.is_file():
        verdict = read_json(summary, ExportError).get("verdict", {})
        rows = (("verdict", "headline"), ("tests", "rests_on"), ("rests on", "given"), ("for use", "use"))
        told += [(name, str(verdict[key])) for name, key in rows if verdict.get(key)]
    return tuple(told)
