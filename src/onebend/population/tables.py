"""The tables of a population, each as Parquet and as CSV."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from onebend.population.curves import Curves
from onebend.population.needed import NUMBERS
from onebend.population.outcome import PopulationOutcome

TABLES = {
    "groups": "a row a group: how many objects, the band of its mean, how many objects the wished band needs",
    "means": "a row a group and place: mean k(s) with its 95 % band",
    "ratios": "a row a pair of groups and place: the first group's mean over the second's, with its 95 % band",
    "spread": "a row a number: spread within and between groups, repeatability, with 95 % intervals",
    "objects": "a row an object: k at five places, why it is unlike the others, whether it passes",
    "curves": "a row an object and place: k(s) as it and the others of its group tell, with its 95 % band",
    "needed": "a row a group and number of objects: the half band of the mean that is to be expected",
    "left_out": "a row a recording that is not in it, with the reason",
}
AT = (0.0, 0.25, 0.5, 0.75, 1.0)  # s, where the table of objects has k


def tables(outcome: PopulationOutcome) -> dict[str, pa.Table]:
    """All of `TABLES`, by name."""
    made = (_groups, _means, _ratios, _spread, _objects, _curves, _needed, _left_out)
    return {name: pa.table(one(outcome)) for name, one in zip(TABLES, made, strict=True)}


def _groups(outcome: PopulationOutcome) -> dict[str, Any]:
    trial = outcome.named.trial
    next_inside = np.full(trial.groups, np.nan) if outcome.next_inside is None else outcome.next_inside
    return {
        "group": _texts(outcome.named.groups),
        "objects": np.bincount(trial.group_of),
        "recordings": np.bincount(trial.group_of[trial.object_of]),
        "half_band": np.expm1(outcome.half),
        "wished_half_band": np.full(trial.groups, outcome.setting.wished),
        "objects_needed": np.array(outcome.needed),
        "next_object_inside": next_inside,
    }


def _means(outcome: PopulationOutcome) -> dict[str, Any]:
    return {
        "group": _each(outcome.named.groups, outcome),
        **_curve(outcome.means, outcome, "k", "_N_m"),
        "identified": outcome.told.ravel(),
        "within_sd": np.tile(outcome.within, outcome.named.trial.groups),
    }


def _ratios(outcome: PopulationOutcome) -> dict[str, Any]:
    groups = outcome.named.groups
    return {
        "group": _each([groups[i] for i, _ in outcome.pairs], outcome),
        "over": _each([groups[j] for _, j in outcome.pairs], outcome),
        **_curve(outcome.ratios, outcome, "ratio", ""),
    }


def _spread(outcome: PopulationOutcome) -> dict[str, Any]:
    found = vars(outcome.shares)
    return {
        "quantity": _texts(found),
        **{name: np.array([getattr(one, name) for one in found.values()]) for name in ("value", "low", "high")},
    }


def _objects(outcome: PopulationOutcome) -> dict[str, Any]:
    named, curves, judged = outcome.named, outcome.curves, outcome.judgement
    trial = named.trial
    columns: dict[str, Any] = {
        "object": _texts(named.objects),
        "group": _texts([named.groups[i] for i in trial.group_of]),
        "recordings": np.bincount(trial.object_of),
    }
    for s in AT:
        i = int(np.argmin(np.abs(trial.s - s)))
        for name, one in (("k", curves.mean), ("k_lo", curves.low), ("k_hi", curves.high)):
            columns[f"{name}_at_{s:g}_N_m"] = np.exp(one[:, i])
    columns["outlier"] = _texts(outcome.outliers)
    columns["inside"] = np.full(trial.objects, np.nan) if judged is None else judged.inside
    words = [""] * trial.objects if judged is None else ["passes" if one else "fails" for one in judged.passed]
    return columns | {"judged": _texts(words)}


def _curves(outcome: PopulationOutcome) -> dict[str, Any]:
    named = outcome.named
    return {
        "object": _each(named.objects, outcome),
        "group": _each([named.groups[i] for i in named.trial.group_of], outcome),
        **_curve(outcome.curves, outcome, "k", "_N_m"),
    }


def _needed(outcome: PopulationOutcome) -> dict[str, Any]:
    return {
        "group": _texts([name for name in outcome.named.groups for _ in NUMBERS]),
        "objects": np.tile(NUMBERS, len(outcome.named.groups)),
        "half_band": np.expm1(outcome.bands).ravel(),
    }


def _left_out(outcome: PopulationOutcome) -> dict[str, Any]:
    rows = outcome.named.left_out
    return {"recording": _texts([name for name, _ in rows]), "reason": _texts([why for _, why in rows])}


def _texts(words: Any) -> pa.Array:
    return pa.array(list(words), pa.string())


def _each(names: Any, outcome: PopulationOutcome) -> pa.Array:
    """A name for every place of its curve."""
    return _texts(name for name in names for _ in outcome.named.trial.s)


def _curve(curves: Curves, outcome: PopulationOutcome, name: str, unit: str) -> dict[str, Any]:
    return {
        "s": np.tile(outcome.named.trial.s, len(curves.mean)),
        f"{name}{unit}": np.exp(curves.mean).ravel(),
        f"{name}_lo{unit}": np.exp(curves.low).ravel(),
        f"{name}_hi{unit}": np.exp(curves.high).ravel(),
    }
