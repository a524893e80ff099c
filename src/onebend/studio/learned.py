"""Learn: contents of a result, and the film with the fitted beam."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from onebend.beam.stiffness import UncertainStiffness
from onebend.errors import StudioError
from onebend.files.publish import LARGEST, SUMMARY, read_object
from onebend.results.model import StoredModel, read_model
from onebend.studio.places import StudioFolder
from onebend.studio.words import Asked, object_of, objects_of

REPORT = "report.html"
_LARGEST_REPORT = 32 * 2**20  # bytes
_DATA = re.compile(r'<script type="application/json" id="data">(.*?)</script>', re.DOTALL)
_S = np.linspace(0.0, 1.0, 101)
_LEVELS = (0.95, 0.8, 0.5)


def result_data(places: StudioFolder, asked: Asked) -> dict[str, Any]:
    """Verdict, k(s) with bands, errors and remarks. Raises `ResultsError` for an unreadable model."""
    name = asked.name()
    folder = places.result(name)
    stored = read_model(folder)
    summary = read_object(folder / SUMMARY, LARGEST) or {}
    fit, origin = object_of(summary.get("fit")), object_of(summary.get("provenance"))
    return {
        "name": name,
        "changed": [words for words in (stored.changed, stored.swapped) if words],
        "length_m": stored.beam.length,
        "curve": curve(stored),
        "verdict": summary.get("verdict"),
        **{key: summary.get(key, []) for key in ("recordings", "training", "validation")},
        "fitted_rms_m": fit.get("fitted_rms_m"),
        "allowances": [one for one in objects_of(fit.get("allowances")) if one.get("matters")],
        "remarks": [one for one in objects_of(summary.get("remarks")) if one.get("level") == "warning"],
        "command": origin.get("command"),
        "written": origin.get("written"),
        "report": (folder / REPORT).is_file(),
    }


def curve(stored: StoredModel) -> dict[str, Any]:
    """k(s) in N m at 101 places, with bands."""
    known = {} if stored.uncertain is None else known_curve(stored.uncertain)
    return {"bands": [], **known, "s": _S.tolist(), "k_N_m": np.asarray(stored.beam.stiffness(_S)).tolist()}


def known_curve(known: UncertainStiffness) -> dict[str, Any]:
    """The same without a model."""
    found: dict[str, Any] = {"s": _S.tolist(), "k_N_m": np.asarray(known.profile(_S)).tolist(), "bands": []}
    for level in _LEVELS:
        band = known.band(_S, level)
        found["bands"].append({"level": level, "low_N_m": band.low.tolist(), "high_N_m": band.high.tolist()})
    found["identified"] = known.band(_S).identified.tolist()
    found["doubts"] = list(known.doubts)
    return found


def film_data(places: StudioFolder, asked: Asked) -> dict[str, Any] | None:
    """The report's frames with the fitted beam in pixels; None without a film. Raises `StudioError` without a report of
    onebend."""
    folder = places.result(asked.name())
    path = folder / REPORT
    try:
        if path.is_symlink():  # which may lead anywhere
            raise OSError(f"{path.name} is a link")
        if path.stat().st_size > _LARGEST_REPORT:
            raise StudioError(f"{path.name} is larger than any report. Learn again")
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise StudioError(
            f"{folder.name} has no report to take the film from. Learn again without --no-report"
        ) from error
    held = _DATA.search(text)
    try:
        data = json.loads(held[1]) if held else {}
        film = data.get("film")
    except (ValueError, AttributeError, RecursionError) as error:
        raise StudioError(f"{path.name} was changed. Learn again") from error
    if not isinstance(film, dict):
        return None
    return film | {"tag_id": object_of(data.get("curve")).get("tag_id", [])}
