"""`report.html`: one self-contained page, figures and style inside, nothing fetched from anywhere."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from onebend.learning.outcome import Comparison, Trial
from onebend.records import Observations
from onebend.report.findings import Findings, all_remarks
from onebend.report.wording import (
    assumptions,
    cards,
    files_described,
    inputs,
    millimetres,
    percent,
    significant,
    stage_rows,
)

FAMILIES = {"gaussians": "Gaussians", "powers": "powers of s"}
METHODS = {"regression": "regression", "paper": "the paper's literal regression"}


def page(findings: Findings, figures: Mapping[str, bytes], *, version: str) -> str:
    """The report as HTML. `figures`: PNGs by name, as `onebend.report.drawing.draw_all` gives them; missing ones are
    left out."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string(files("onebend.report").joinpath("page.html").read_text(encoding="utf-8"))
    encoded = {name: base64.b64encode(png).decode("ascii") for name, png in figures.items()}
    return template.render(figures=encoded, version=version, **_content(findings))


def _content(findings: Findings) -> dict[str, Any]:
    learned, seen = findings.learned, findings.observations
    remarks = [{"recording": whose, "level": r.level, "text": r.text} for whose, r in all_remarks(findings)]
    return {
        "name": seen.name,
        "length": f"{1000 * seen.length:.4g} mm",
        "frames": _frames(seen),
        "method": METHODS.get(learned.method, learned.method),
        "family": FAMILIES.get(learned.family, learned.family),
        "chosen": learned.trials[learned.chosen],
        "cards": cards(findings),
        "warnings": [row for row in remarks if row["level"] == "warning"],
        "remarks": remarks,
        "k_rows": _stiffness_rows(findings),
        "tags": [f"M{i + 1}" for i in range(len(seen.tag_id))],
        "trials": [_trial_row(trial, i == learned.chosen) for i, trial in enumerate(learned.trials)],
        "validations": [_validation_row(one) for one in findings.validations],
        "validation_figures": _validation_captions(findings),
        "inputs": inputs(seen),
        "assumptions": assumptions(findings),
        "files": files_described(findings),
        "stages": _stage_rows(findings),
        "video": f"{significant(findings.video_seconds)} s",
    }


def _frames(seen: Observations) -> str:
    return f"{int(seen.loaded.sum())} loaded frames out of {len(seen.time)}"


def _stiffness_rows(findings: Findings) -> list[dict[str, str]]:
    beam = findings.learned.beam
    s = np.linspace(0.0, 1.0, 11)
    return [
        {"s": f"{place:.1f}", "k": significant(k), "ei": significant(1e6 * k * beam.length)}
        for place, k in zip(s, beam.stiffness(s), strict=True)
    ]


def _trial_row(trial: Trial, chosen: bool) -> dict[str, Any]:
    return {
        "kind": "chosen" if chosen else "out" if trial.why_out else "",
        "n": trial.n,
        "m": trial.m,
        "rms": [millimetres(value) for value in trial.rms],
        "bic": f"{trial.bic:.1f}" if np.isfinite(trial.bic) else "–",
        "lowest": significant(trial.lowest_k),
        "condition": significant(trial.condition, 2),
        "why_out": trial.why_out,
    }


def _validation_row(one: Comparison) -> dict[str, Any]:
    pairs = zip(one.rms, one.sensor_rms, strict=True)
    cells = [{"rms": millimetres(rms), "sensor": millimetres(sensor)} for rms, sensor in pairs]
    return {"name": one.name, "frames": len(one.frame), "cells": cells}


def _validation_captions(findings: Findings) -> list[tuple[str, str]]:
    captions = []
    for i, one in enumerate(findings.validations, start=1):
        captions.append((f"validation-{i}-shapes", f"{one.name}: simulated beam and measured markers."))
        captions.append((f"validation-{i}-residuals", f"{one.name}: distance between measured and simulated markers."))
    return captions


def _stage_rows(findings: Findings) -> list[dict[str, str]]:
    return [
        {"name": name, "seconds": f"{seconds:.2f}", "share": percent(seconds, findings.video_seconds)}
        for name, seconds in stage_rows(findings.stage_seconds)
    ]
