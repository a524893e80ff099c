"""The files of a results folder, written from what was found. Where they go and when is `folder`'s business."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from onebend.files.manifest import write_summary
from onebend.learning.design.instruments import instruments_if_pushed
from onebend.learning.modulus import stated_section
from onebend.learning.outcome import Comparison
from onebend.records import Observations
from onebend.report.figures.pictures import Pictures
from onebend.report.findings import Findings
from onebend.report.page.made_from import shown_made_from
from onebend.report.page.page import page
from onebend.results.model import FILE_NAME, StoredModel, model_text
from onebend.results.observations_file import save_observations
from onebend.results.origin import origin_of
from onebend.results.tables import (
    write_markers,
    write_nuisances,
    write_selection,
    write_stiffness,
    write_validation,
)

Writer = Callable[[Path], None]  # fills a folder


def learned_writer(
    findings: Findings,
    pictures: Pictures | None,
    summary: Mapping[str, Any],
    *,
    version: str,
    made_from: Mapping[str, Any] = {},
    tables: Writer | None = None,
) -> Writer:
    """What `publish` needs to fill a folder with the results of learning.

    Args:
        pictures: of the report; None: without a report.
        made_from: what `provenance` gives, for the report to show.
        tables: what writes the model and the tables; None: `tables_writer`.
    """
    write_tables = tables or tables_writer(findings, version=version)

    def write(folder: Path) -> None:
        write_tables(folder)
        if pictures is not None:
            shown = shown_made_from(made_from)
            html = page(findings, pictures.drawn, version=version, made_from=shown, film=pictures.film)
            (folder / "report.html").write_text(html, encoding="utf-8")
            _write_figures(folder, pictures)
        write_summary(folder, summary)

    return write


def tables_writer(findings: Findings, *, version: str) -> Writer:
    """What fills an empty folder with the model, the tables and the observations; they are made once, however often
    they are written."""
    made: dict[str, bytes] = {}

    def write(folder: Path) -> None:
        if not made:
            _write_tables(folder, findings, version)
            made.update({path.name: path.read_bytes() for path in folder.iterdir()})
        else:
            for name, content in made.items():
                (folder / name).write_bytes(content)

    return write


def _write_tables(folder: Path, findings: Findings, version: str) -> None:
    learned, posterior = findings.learned, findings.posterior
    uncertain = None if posterior is None else posterior.stiffness
    origin = origin_of(learned, posterior, findings.trainings)
    bench = None if posterior is None else instruments_if_pushed(posterior)
    beam, section = findings.beam, stated_section(findings.recordings)
    stored = StoredModel(beam, origin, uncertain, bench, section=section)
    (folder / FILE_NAME).write_text(model_text(stored, written_by=f"onebend {version}"), encoding="utf-8")
    write_stiffness(folder / "stiffness.csv", beam, uncertain, section)
    if learned is not None:
        write_selection(folder / "selection.csv", learned)
    if posterior is not None:
        write_nuisances(folder / "nuisances.csv", posterior.nuisances())
    write_markers(folder / "markers.csv", (*findings.trainings, *findings.validations))
    if findings.validations:
        write_validation(folder / "validation.csv", findings.validations)
    for i, recording in enumerate(findings.recordings, start=1):
        save_observations(folder / f"observations{'' if i == 1 else f'-{i}'}.parquet", recording)


def validation_writer(
    pairs: Sequence[tuple[Comparison, Observations]], pictures: Pictures, summary: Mapping[str, Any]
) -> Writer:
    """What `publish` needs to fill a folder with a validation."""

    comparisons = [comparison for comparison, _ in pairs]

    def write(folder: Path) -> None:
        write_validation(folder / "validation.csv", comparisons)
        write_markers(folder / "markers.csv", comparisons)
        _write_figures(folder, pictures)
        write_summary(folder, summary)

    return write


def _write_figures(folder: Path, pictures: Pictures) -> None:
    (folder / "figures").mkdir()
    pictures.write(folder / "figures")
