"""`report.html`: one self-contained page, figures and style inside, nothing fetched from anywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from onebend.beam.profiles.uncertain import half_width_words
from onebend.learning.criticism_messages import unseen_words
from onebend.learning.frequencies.compared import compared_frequencies
from onebend.learning.outcome import Comparison, Learned, Trial
from onebend.learning.posterior import Posterior
from onebend.learning.verdict import fitted_rms, possible
from onebend.records import Observations
from onebend.report.allowance_words import mounting_words
from onebend.report.confidence import (
    alarm_words,
    allowance_rows,
    load_error_words,
    model_test_rows,
    nuisance_rows,
    scale_words,
    stop_words,
    tradeoff_words,
    unidentified_words,
)
from onebend.report.figures.film import FilmStrip
from onebend.report.findings import Findings, all_remarks, name_of
from onebend.report.kinds import learned_from, only_frequencies, only_static, words_of
from onebend.report.modulus import measured_beam, modulus_rows, modulus_words, one_modulus_words
from onebend.report.page.cards import cards
from onebend.report.page.interactive import SCRIPTS, script_data
from onebend.report.page.made_from import MadeFrom
from onebend.report.page.template import COMMON, render
from onebend.report.verdict import verdict_of
from onebend.report.wording import (
    assumptions,
    bic_words,
    files_described,
    inputs,
    millimetres,
    percent,
    significant,
    stage_rows,
)

FAMILIES = {"gaussians": "Gaussians", "powers": "powers of s"}
METHODS = {"regression": "regression", "paper": "the paper's literal regression"}


def page(
    findings: Findings,
    figures: Mapping[str, bytes],
    *,
    version: str,
    made_from: MadeFrom | None = None,
    film: FilmStrip | None = None,
) -> str:
    """The report as HTML. `figures`: PNGs by name, as from `drawing.draw_all`; a missing one is left out."""
    content: dict[str, Any] = {"version": version, "made_from": made_from, "film": film, **_content(findings)}
    content["data"] = script_data(findings, film)
    return render(COMMON, "page.html", figures, content, scripts=SCRIPTS)


def _content(findings: Findings) -> dict[str, Any]:
    learned, first = findings.learned, findings.recordings[0]
    remarks = [{"recording": whose, **remark.as_dict(), "docs": remark.docs} for whose, remark in all_remarks(findings)]
    return {
        "name": name_of(findings),
        "several": len(findings.recordings) > 1,
        "length": f"{1000 * first.length:.4g} mm",
        "frames": " and ".join(learned_from(recording) for recording in findings.recordings),
        "words": words_of(first),
        "heavy": bool(np.any(first.gravity)),
        "static": findings.posterior is not None and only_static(findings.recordings),
        "method": "" if learned is None else METHODS.get(learned.method, learned.method),
        "family": "" if learned is None else FAMILIES.get(learned.family, learned.family),
        "chosen": None if learned is None else learned.trials[learned.chosen],
        "cards": cards(findings),
        "verdict": verdict_of(findings),
        "warnings": [row for row in remarks if row["level"] == "warning"],
        "remarks": remarks,
        "fit": None if findings.posterior is None else _fit(findings.posterior, findings.recordings),
        "k_rows": _stiffness_rows(findings),
        "modulus": modulus_rows(measured_beam(findings), np.linspace(0.0, 1.0, 11)),
        "modulus_words": modulus_words(measured_beam(findings)),
        "one_modulus": bool(one_modulus_words(measured_beam(findings))),
        "tags": [f"tag {tag}" for tag in first.tag_id],
        "swings": _frequency_rows(findings.posterior),
        "only_swings": only_frequencies(findings.recordings),
        "trainings": [_comparison_row(comparison) for comparison in findings.trainings],
        "learned_figures": _learned_captions(findings),
        "trials": [] if learned is None else _trials(learned),
        "validations": [_comparison_row(comparison) for comparison in findings.validations],
        "validation_figures": _validation_captions(findings.validations),
        "inputs": [(recording.source.name, inputs(recording)) for recording in findings.recordings],
        "assumptions": assumptions(findings),
        "files": files_described(findings),
        "stages": _stage_rows(findings),
        "video": f"{significant(findings.video_seconds)} s" if findings.video_seconds > 0.0 else "",
    }


def _fit(posterior: Posterior, recordings: Sequence[Observations]) -> dict[str, Any]:
    """What the page says of the fit."""
    rms = zip(recordings, fitted_rms(posterior), strict=True)
    return {
        "doubts": "; ".join(posterior.doubts),
        "holds": posterior.criticism.trusted,
        "allowances": allowance_rows(posterior),
        "tests": model_test_rows(posterior),
        "testable": bool(possible(posterior).criticism.able),
        "alarm": alarm_words(posterior),
        "unseen": unseen_words(possible(posterior)),
        "blind": unidentified_words(posterior.stiffness, len(recordings)),
        "gain": " ".join(
            [
                scale_words(posterior.gain_sd, recordings),
                *load_error_words(posterior.load_error),
                mounting_words(posterior),
            ]
        ),
        "stopped": stop_words(posterior),
        "nuisances": nuisance_rows(posterior.nuisances()),
        "tradeoffs": tradeoff_words(posterior),
        "fitted": [{"name": one.source.name, "rms": [millimetres(value) for value in values]} for one, values in rms],
    }


def _stiffness_rows(findings: Findings) -> list[dict[str, Any]]:
    beam, posterior = findings.beam, findings.posterior
    s = np.linspace(0.0, 1.0, 11)
    rows: list[dict[str, Any]] = [
        {"s": f"{place:.1f}", "k": significant(k), "ei": significant(1e6 * k * beam.length), "known": True}
        for place, k in zip(s, beam.stiffness(s), strict=True)
    ]
    if posterior is not None:
        band = posterior.band(s)
        for row, low, high, known in zip(rows, band.low, band.high, band.identified, strict=True):
            row |= {"low": significant(low), "high": significant(high), "known": bool(known)}
            row["half"] = (
                half_width_words(0.5 * float(np.log(high / low))).removeprefix("± ").replace("a factor of ", "× ")
            )
    if posterior is not None and findings.learned is not None:
        for row, k in zip(rows, findings.learned.beam.stiffness(s), strict=True):
            row["regression"] = significant(k)
    return rows


def _frequency_rows(posterior: Posterior | None) -> list[dict[str, str]]:
    rows = () if posterior is None else compared_frequencies(posterior.frequencies)
    return [
        {
            "name": row.recording,
            "mode": str(row.mode),
            "posture": row.posture,
            "measured": f"{row.measured:.5g}",
            "sd": f"{row.sd:.2g}",
            "fitted": f"{row.fitted:.5g}",
            "off": f"{row.off:+.1f}",
        }
        for row in rows
    ]


def _trials(learned: Learned) -> list[dict[str, Any]]:
    return [_trial_row(trial, i == learned.chosen) for i, trial in enumerate(learned.trials)]


def _trial_row(trial: Trial, chosen: bool) -> dict[str, Any]:
    return {
        "kind": "chosen" if chosen else "out" if trial.why_out else "",
        "n": trial.n,
        "m": trial.m,
        "rms": [millimetres(value) for value in trial.rms],
        "bic": bic_words(trial.bic),
        "lowest": significant(trial.lowest_k),
        "condition": significant(trial.condition, 2),
        "why_out": trial.why_out,
    }


def _comparison_row(comparison: Comparison) -> dict[str, Any]:
    pairs = zip(comparison.rms, comparison.sensor_rms, strict=True)
    cells = [{"rms": millimetres(rms), "noise": millimetres(noise)} for rms, noise in pairs]
    return {"name": comparison.name, "frames": len(comparison.frame), "cells": cells}


def _validation_captions(comparisons: Sequence[Comparison]) -> list[tuple[str, str]]:
    captions = []
    for i, comparison in enumerate(comparisons, start=1):
        captions.append((f"validation-{i}-shapes", f"{comparison.name}: simulated beam and measured tags."))
        captions.append(
            (f"validation-{i}-residuals", f"{comparison.name}: distance between measured and simulated tags.")
        )
    return captions


def _learned_captions(findings: Findings) -> list[tuple[str, str]]:
    """Figures of the recordings after the first, whose own stand in the text."""
    captions = []
    for i, comparison in enumerate(findings.trainings[1:], start=2):
        words = words_of(findings.recordings[i - 1])
        captions.append((f"learned-{i}-shapes", f"{comparison.name}: the beam and measured tags."))
        captions.append((f"learned-{i}-fitted", f"{comparison.name}: what the fit leaves of the tags."))
        captions.append((f"learned-{i}-residuals", f"{comparison.name}: measured to simulated {words.under}."))
    return captions


def _stage_rows(findings: Findings) -> list[dict[str, str]]:
    return [
        {"name": name, "seconds": f"{seconds:.2f}", "share": percent(seconds, findings.video_seconds)}
        for name, seconds in stage_rows(findings.stage_seconds)
    ]
